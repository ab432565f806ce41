"""Segment headers: each reason to refuse one, and how that is said."""

from __future__ import annotations

import os

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
    assert all(len(name) <= 24 for name in NAMES)


def test_absent(name: str) -> None:
    for attempt in (
        lambda: segments.attach(name, "gate"),
        lambda: segments.attach(name, "gate", RUN, write=True),
        lambda: segments.attach(name, "client.0", RUN, write=True),
    ):
        kind, message = refusal(attempt)
        assert kind == "absent"
        assert repr(name) in message
        assert "failstop run" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
@pytest.mark.parametrize("damage", ["zeros", "noise", "one bit", "other magic", "short header", "empty", "cut"])
def test_a_damaged_header(name: str, of: str, damage: str) -> None:
    segments.create(name, of, RUN).close()
    path = path_of(name, of)
    with open(path, "r+b") as file:
        if damage == "zeros":
            file.write(bytes(128))
        elif damage == "noise":
            file.write(os.urandom(128))
        elif damage == "one bit":
            file.seek(90)
            byte = file.read(1)[0]
            file.seek(90)
            file.write(bytes([byte ^ 1]))
        elif damage == "short header":
            file.write(cell.build(1, 0, segments.MAGIC, HEADER_SEED, 104))
        elif damage == "empty":
            file.truncate(0)
        elif damage == "cut":
            file.truncate(100)
    if damage == "other magic":
        write_header(name, of, magic=b"failstom")
    kind, message = refusal(lambda: attach_any(name, of))
    assert kind == "damaged"
    assert "no whole header" in message
    assert of in message
    assert "restart the service" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_another_layout_is_another_version(name: str, of: str) -> None:
    """Said before anything else in the header is judged, since nothing else need mean the same there."""
    segments.create(name, of, RUN).close()
    for other in ({}, {"size": 77}, {"run": 1}, {"name": "other"}):
        write_header(name, of, layout=LAYOUT_HASH ^ 1, version="9.8.7", **other)
        kind, message = refusal(lambda: attach_any(name, of))
        assert kind == "version"
        assert "is of failstop 9.8.7, this program is" in message
        assert VERSION in message
        assert "restart the service" in message


def test_another_version_is_told_whatever_it_is_made_of(name: str) -> None:
    segments.create(name, "gate", RUN).close()
    write_header(name, "gate", layout=LAYOUT_HASH ^ 1, version="9\u00e4")
    assert "is of failstop 9\ufffd\ufffd, this program is" in refusal(lambda: attach_any(name, "gate"))[1]


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_the_version_alone_is_no_reason(name: str, of: str) -> None:
    segments.create(name, of, RUN).close()
    write_header(name, of, version="9.8.7")
    attach_any(name, of).close()


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_another_run(name: str, of: str) -> None:
    segments.create(name, of, RUN).close()
    kind, message = refusal(lambda: attach_any(name, of, RUN + 1))
    assert kind == "damaged"
    assert "another run" in message


@pytest.mark.parametrize("wrong", [{"size": 4096 * 99}, {"name": "telemetry"}])
def test_a_header_of_another_segment(name: str, wrong: dict[str, object]) -> None:
    segments.create(name, "gate", RUN).close()
    write_header(name, "gate", **wrong)  # type: ignore[arg-type]
    kind, message = refusal(lambda: segments.attach(name, "gate", RUN))
    assert kind == "damaged"
    assert "wrong size or name" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_a_file_that_is_too_small_is_not_mapped(name: str, of: str) -> None:
    segments.create(name, of, RUN).close()
    for size in (SEGMENT_BY_NAME[of].size - 1, 4095, 128):
        os.truncate(path_of(name, of), size)
        kind, message = refusal(lambda: attach_any(name, of))
        assert kind == "damaged"
        assert "wrong size or name" in message


def test_cells_of_another_run_are_not_read(name: str) -> None:
    """Even with every byte of the dead run's records in place."""
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
