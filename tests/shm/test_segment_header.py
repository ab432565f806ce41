"""Segment headers: each reason to refuse one, and how that is said."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from typing import Any

import pytest

from failstop.messages import segments
from failstop.messages.layout import LAYOUT_HASH, SEGMENT_BY_NAME
from failstop.shm import cell
from failstop.shm.segment import HEADER_BYTES
from failstop.version import VERSION

from .segments import HEADER, HEADER_SEED, NAMES, RUN, attach_any, content, path_of, refusal, write_header


def test_the_header_fits_its_place(name: str) -> None:
    assert cell.CELL_HEADER_BYTES + HEADER.size <= HEADER_BYTES
    segments.create(name, "gate", RUN).close()
    before = content(path_of(name, "gate"))
    write_header(name, "gate")
    assert content(path_of(name, "gate")) == before, "it is what a segment is made with"
    assert len(VERSION.encode()) <= 24
    assert all(len(name) <= 16 for name in NAMES)


def test_a_segment_that_is_absent_is_told(name: str) -> None:
    for of, write in (("gate", False), ("gate", True), ("client.0", True)):
        kind, message = refusal(lambda of=of, write=write: segments.attach(name, of, RUN, write=write))  # type: ignore[misc]
        assert kind == "absent"
        assert repr(name) in message
        assert "failstop run" in message


def test_the_version_that_made_a_run_is_read_where_another_one_looks(name: str) -> None:
    assert segments.version(name) == ""
    segments.create(name, "supervisor", RUN).close()
    assert segments.version(name) == VERSION
    write_header(name, "supervisor", layout=LAYOUT_HASH ^ 1)
    assert segments.version(name) == VERSION, "a layout that this program can't attach to"
    cut(HEADER.size)(name, "supervisor")
    assert segments.version(name) == ""


Spoil = Callable[[str, str], object]


def bytes_at(at: int, data: bytes) -> Spoil:

    def spoil(name: str, of: str) -> None:
        with open(path_of(name, of), "r+b") as file:
            file.seek(at)
            file.write(data)

    return spoil


def cut(size: int) -> Spoil:
    """Truncate the file; a negative size is counted from its end."""
    return lambda name, of: os.truncate(path_of(name, of), size if size >= 0 else SEGMENT_BY_NAME[of].size + size)


def header(**words: Any) -> Spoil:
    return lambda name, of: write_header(name, of, **words)


NO_HEADER = ("damaged", "an incomplete header")
NO_FILE = ("damaged", "wrong size or name")
OTHER = {"layout": LAYOUT_HASH ^ 1, "version": "9.8.7"}
OTHER_VERSION = ("version", f"is of failstop 9.8.7, this program is {VERSION}")


@pytest.mark.parametrize("of", ["gate", "client.0"])
@pytest.mark.parametrize(
    ("spoil", "refused"),
    [
        (bytes_at(0, bytes(128)), NO_HEADER),
        (bytes_at(0, random.Random(1).randbytes(128)), NO_HEADER),
        (bytes_at(90, b"\xff"), NO_HEADER),
        (header(magic=b"failstom"), NO_HEADER),
        (bytes_at(0, cell.build(1, 0, segments.MAGIC, HEADER_SEED, 104)), NO_HEADER),
        *((cut(size), NO_HEADER) for size in (0, 1, 23, 24, 103)),
        # Another layout is told before anything else is judged: nothing else need mean the same there.
        *((header(**OTHER, **other), OTHER_VERSION) for other in ({}, {"size": 77}, {"run": 1}, {"name": "other"})),
        (header(layout=LAYOUT_HASH ^ 1, version="9\u00e4"), ("version", "is of failstop 9\ufffd\ufffd, this")),
        (header(run=RUN + 1), ("damaged", "another run")),
        (header(size=4096 * 99), NO_FILE),
        (header(name="telemetry"), NO_FILE),
        (cut(-1), NO_FILE),
        *((cut(size), NO_FILE) for size in (104, 127, 128, 4095)),
        (header(version="9.8.7"), None),
    ],
)
def test_a_header_is_refused_by_kind(name: str, of: str, spoil: Spoil, refused: tuple[str, str] | None) -> None:
    segments.create(name, of, RUN).close()
    spoil(name, of)
    if refused is None:
        attach_any(name, of).close()
        return
    kind, message = refusal(lambda: attach_any(name, of))
    assert (kind, refused[1] in message) == (refused[0], True), message
    if refused in (NO_HEADER, OTHER_VERSION):
        assert of in message
        assert "restart the service" in message


def test_a_header_with_any_byte_changed_is_refused(name: str) -> None:
    segments.create(name, "gate", RUN).close()
    whole = content(path_of(name, "gate"))[:104]
    for at, byte in enumerate(whole):
        bytes_at(0, whole[:at] + bytes([byte ^ 0x10]) + whole[at + 1 :])(name, "gate")
        assert refusal(lambda: attach_any(name, "gate"))[0] == "damaged"


def test_cells_of_another_run_are_not_read(name: str) -> None:
    segments.create(name, "gate", 1).close()
    own = segments.attach(name, "gate", 1, write=True)
    own.latest_writer("state").write(b"old", 1)
    own.ring_writer("frames").put(b"old", 1)
    with open(path_of(name, "gate"), "rb") as file:
        old = file.read()
    segments.unlink(name, "gate")
    segments.create(name, "gate", 2).close()
    with open(path_of(name, "gate"), "r+b") as file:
        file.seek(HEADER_BYTES)
        file.write(old[HEADER_BYTES:])
    seen = segments.attach(name, "gate", 2)
    assert seen.latest_reader("state").read() is None
    assert seen.ring_reader("frames", from_oldest=True).next() is None


def test_client_records_of_another_run_are_not_read(name: str) -> None:
    """The header of a client's segment is not looked at by the service: each record must say its run."""
    segments.create(name, "client.0", 1).close()
    segments.attach(name, "client.0", 1, write=True).latest_writer("command").write(b"drive", 1)
    assert segments.read_client_slot(name, 0, 1).latest_reader("command").read() == (1, 1, b"drive")
    assert segments.read_client_slot(name, 0, 2).latest_reader("command").read() is None
