"""The layout: every record has a place, a writer and a reader of its own, and its hash knows all of it."""

from __future__ import annotations

import importlib.util
import re
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest

from failstop.messages import layout
from failstop.messages.layout import CLIENT_HASH, CLIENT_SLOTS, LAYOUT_HASH, PROCESS_NAMES, SEGMENT_BY_NAME, SEGMENTS
from failstop.shm import cell, segment
from failstop.shm.cell import cell_bytes
from failstop.shm.segment import HEADER_BYTES, Record, SegmentSpec
from failstop.shm.words import LINE_BYTES

SOURCE = Path(layout.__file__).read_text()


def variant(pattern: str, replacement: str) -> ModuleType:
    """The layout module with one declaration changed, wherever it stands."""
    text, count = re.subn(pattern, replacement, SOURCE)
    assert count, f"{pattern} is not in the layout any more"
    assert text != SOURCE
    spec = importlib.util.spec_from_loader(layout.__name__, loader=None)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    exec(compile(text, "layout_variant.py", "exec"), module.__dict__)
    return module


def places(spec: SegmentSpec) -> list[tuple[int, int, str]]:
    return [(spec.offsets[name], spec.offsets[name] + record.size(), name) for name, record in spec.records.items()]


@pytest.mark.parametrize("spec", SEGMENTS, ids=lambda spec: spec.name)
def test_records_lie_on_lines_of_their_own_in_whole_pages(spec: SegmentSpec) -> None:
    taken = sorted(places(spec))
    assert taken[0][0] >= HEADER_BYTES
    for (_, end, one), (start, _, other) in pairwise(taken):
        assert end <= start, f"{one} overlaps {other}"
    assert [name for start, end, name in taken if start % LINE_BYTES or end % LINE_BYTES] == []
    assert taken[-1][1] <= spec.size < 4 * 1024 * 1024
    assert spec.size % 4096 == 0


@pytest.mark.parametrize("spec", SEGMENTS, ids=lambda spec: spec.name)
def test_every_segment_has_a_writer_and_every_record_a_reader(spec: SegmentSpec) -> None:
    assert spec.writer.strip()
    assert spec.records
    known = {*PROCESS_NAMES, "clients", "everyone", "its successor", "the client of that slot"}
    for record in spec.records.values():
        assert record.kind in ("word", "latest", "ring", "futexes")
        readers = {reader.strip() for reader in record.readers.split(",")}
        assert readers - {""}, record.name
        if record.kind != "futexes":
            assert readers <= known - {spec.writer}, record.name


def test_no_record_is_declared_twice() -> None:
    """A second one of the same name would silently replace the first and leave a hole."""
    for spec in SEGMENTS:
        taken = sum(record.size() for record in spec.records.values())
        assert taken == max(end for _, end, _ in places(spec)) - HEADER_BYTES
    assert len(SEGMENT_BY_NAME) == len(SEGMENTS)


def test_one_segment_for_each_process_and_client_slot() -> None:
    assert [spec.name for spec in SEGMENTS if spec.mode == layout.PUBLIC] == list(PROCESS_NAMES)
    assert [spec.name for spec in SEGMENTS if spec.mode == layout.CLIENTS_WRITE] == [
        f"client.{i}" for i in range(CLIENT_SLOTS)
    ]
    for process in PROCESS_NAMES:
        assert SEGMENT_BY_NAME[process].writer == process


def test_modes() -> None:
    """Nobody but the service's own user writes what the service maps; only client segments are the group's to write."""
    for spec in SEGMENTS:
        assert spec.mode & 0o7113 == 0
        assert bool(spec.mode & 0o020) == spec.name.startswith("client.")
        if spec.name.startswith("client."):
            assert "word" not in {record.kind for record in spec.records.values()}, "not without a mapping"


def test_each_client_slot_has_its_reply() -> None:
    replies = [name for name in SEGMENT_BY_NAME["gate"].records if name.startswith("reply.")]
    assert replies == [f"reply.{i}" for i in range(CLIENT_SLOTS)]


def test_every_process_has_a_whole_heartbeat() -> None:
    beats = {name for name in SEGMENT_BY_NAME["supervisor"].records if name.startswith("beat_")}
    assert len(beats) == 6
    for process in PROCESS_NAMES:
        assert beats <= set(SEGMENT_BY_NAME[process].records)


@pytest.mark.parametrize("capacity", [0, 1, 39, 40, 41, 104, 105, 2048])
def test_a_cell_holds_its_capacity_and_shares_no_line(capacity: int) -> None:
    assert cell_bytes(capacity) >= cell.CELL_HEADER_BYTES + capacity
    assert cell_bytes(capacity) - cell.CELL_HEADER_BYTES - capacity < LINE_BYTES
    assert cell_bytes(capacity) % LINE_BYTES == 0


def test_the_hash_tells_of_another_header(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment, "HEADER_BYTES", 192)
    assert variant(r'"""The layout', '"""the layout').LAYOUT_HASH != LAYOUT_HASH


def test_the_hash_is_reproducible() -> None:
    module = variant(r'"""The layout', '"""the layout')
    assert module.LAYOUT_HASH == LAYOUT_HASH
    assert 0 < LAYOUT_HASH < 2**64
    same, here = ([(spec.name, spec.size, spec.offsets) for spec in of.SEGMENTS] for of in (module, layout))
    assert same == here
    gate = module.SEGMENT_BY_NAME["gate"].records
    assert (gate["frames"].capacity, gate["frames"].cells, gate["state"].capacity) == (269, 64, 4096)


@pytest.mark.parametrize(
    ("pattern", "replacement"),
    [
        (r"LAYOUT_VERSION = \d+", "LAYOUT_VERSION = 99"),
        (r"CLIENT_SLOTS = 8", "CLIENT_SLOTS = 7"),
        (r"PUBLIC = 0o644", "PUBLIC = 0o640"),
        (r'"epoch"', '"epoch_"'),
        (r'_word\("beat_worst_ns"[^\n]*', ""),
        (r'"attended": 96', '"attended": 97'),
        (r'_latest\("imu", records.IMU', '_latest("imu", records.ODOMETRY'),
        (r'_ring\("frames", records.FRAME, 64', '_ring("frames", records.FRAME, 63'),
        (r'_ring\("frames", records.FRAME', '_ring("frames", 268'),
        (r'_ring\("events", (\d+), (\d+)', r'_ring("events", \2, \1'),
        (r'_word\("port_number", "supervisor"\),', '_latest("port_number", 8, "supervisor"),'),
        (r'_latest\("battery", records.BATTERY, ', '_word("battery", '),
        (r'(_latest\("battery"[^\n]*)\n\s*(_latest\("odometry"[^\n]*)', r"\2\n            \1"),
        (r'TELEMETRY = "telemetry"', 'TELEMETRY = "telemetri"'),
    ],
)
def test_the_hash_changes_with_every_declaration(pattern: str, replacement: str) -> None:
    changed = variant(pattern, replacement).LAYOUT_HASH
    assert changed >> 32 != LAYOUT_HASH >> 32
    assert changed & 0xFFFFFFFF != LAYOUT_HASH & 0xFFFFFFFF


OF_THE_SERVICE_ALONE = [
    (r"LAYOUT_VERSION = \d+", "LAYOUT_VERSION = 99"),
    (r'(_word\("resets", "gate"\),)', r'\1 _word("resets_again", "gate"),'),
    (r'_ring\("frames", records.FRAME, 64', '_ring("frames", records.FRAME, 63'),
    (r'_ring\("events", (\d+), (\d+)', r'_ring("events", \2, \1'),
]
OF_CLIENTS_TOO = [
    (r"CLIENT_VERSION = \d+", "CLIENT_VERSION = 99"),
    (r'"epoch"', '"epoch_"'),
    (r'(_word\("ready", [^\n]*)', r'_word("more", "clients"), \1'),
    (r'_latest\("imu", records.IMU', '_latest("imu", records.ODOMETRY'),
    (r'_latest\("state", 4096', '_latest("state", 4160'),
]


@pytest.mark.parametrize(("pattern", "replacement"), OF_THE_SERVICE_ALONE + OF_CLIENTS_TOO)
def test_the_c_library_must_follow_only_what_it_reads(pattern: str, replacement: str) -> None:
    changed = variant(pattern, replacement)
    assert (changed.LAYOUT_HASH != LAYOUT_HASH) == ("CLIENT_VERSION" not in pattern)
    assert (changed.CLIENT_HASH != CLIENT_HASH) == ((pattern, replacement) in OF_CLIENTS_TOO)


@pytest.mark.parametrize("pages", [1, 2, 5000])
@pytest.mark.parametrize(("beyond", "more"), [(0, 0), (1, 1)])
def test_a_segment_is_of_whole_pages_and_of_no_more_than_it_needs(pages: int, beyond: int, more: int) -> None:
    record = Record("futexes", "all", "", pages * 4096 - HEADER_BYTES + beyond)
    assert SegmentSpec("any", "", 0o600, (record,)).size == (pages + more) * 4096


def test_importing_the_layout_loads_nothing_heavy() -> None:
    """Processes on the stop path import it first thing."""
    assert "failstop.messages.layout" in sys.modules
    heavy = "dataclasses|typing|enum|re|inspect|pathlib|logging|argparse|json|subprocess|collections.abc"
    assert not re.search(rf"^(import|from) ({heavy})\b", SOURCE, re.MULTILINE)
