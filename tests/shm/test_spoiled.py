"""Bytes that nobody wrote: scribbled over, copied about, cut off. A reader takes a record that was written or none, and
never falls; a successor's is read."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from failstop.shm.cell import Entry, FileView, LatestReader, LatestWriter, RingReader, RingWriter
from tests.support.amounts import amount

from .memory import Memory, payload_of, time_of
from .rings import AT, CAPACITY, CELLS, SEED, SIZE, reader_of, writer_of

if TYPE_CHECKING:
    from failstop.shm.cell import View

Reader = LatestReader | RingReader
KINDS = {"latest": 2, "ring": CELLS}
"""How many cells each has."""


def writer(kind: str, view: View) -> LatestWriter | RingWriter:
    return writer_of(view) if kind == "ring" else LatestWriter(view, AT, CAPACITY, 2, SEED)


def readers(kind: str, view: View) -> list[Reader]:
    if kind == "latest":
        return [LatestReader(view, AT, CAPACITY, 2, SEED)]
    return [reader_of(view, from_oldest=oldest) for oldest in (True, False)]


def written(kind: str, view: View, dice: random.Random) -> set[Entry]:
    """A history in every cell."""
    own, found = writer(kind, view), set()
    for seq in range(1, KINDS[kind] + 6):
        payload = payload_of(seq, dice.randrange(CAPACITY + 1))
        assert own.put(payload, time_of(seq)) == seq
        found.add((seq, time_of(seq), payload))
    return found


def read(reader: Reader) -> Iterator[Entry]:
    """Read all that can be read: once, or a ring to its end."""
    if isinstance(reader, LatestReader):
        yield from filter(None, [reader.read()])
        return
    for _ in range(CELLS + 1):
        if (entry := reader.next()) is None:
            return
        yield entry
    assert reader.next() is None


def check(several: list[Reader], genuine: set[Entry]) -> None:
    for reader in several:
        found = list(read(reader))
        assert set(found) <= genuine
        assert [entry[0] for entry in found] == sorted({entry[0] for entry in found})


def scribbled(now: bytes, image: bytes, dice: random.Random, *, cells: bool) -> bytes:
    """One of many ways to spoil memory that was like the image; `cells`: whole ones may come to another place."""
    size = min(len(image), 1 << dice.randrange(10))
    at, source = (dice.randrange(len(image) - size + 1) for _ in range(2))
    line = dice.randrange(len(image) // 64) * 64
    foreign = bytes(byte ^ (1 << dice.randrange(8)) for byte in image[at : at + 1])
    ways = (dice.randbytes(size), bytes(size), b"\xff" * size, foreign, image[source : source + size])
    moved = [(at // 64 * 64, image[line : line + max(64, size)])] if cells else []
    at, data = dice.choice([*((at, way) for way in ways), *moved])
    return (now[:at] + data[: len(image) - at] + now[at + len(data) :])[: len(image)]


@pytest.mark.parametrize("kind", KINDS)
def test_memory_that_was_scribbled_over_is_read_as_what_was_written(kind: str) -> None:
    dice = random.Random(kind)
    for _ in range(amount(60, 3000)):
        memory = Memory(AT + KINDS[kind] * SIZE)
        genuine = written(kind, memory, dice)
        image, resident = bytes(memory.data), readers(kind, memory)
        for _ in range(8):
            memory.data[:] = scribbled(bytes(memory.data), image, dice, cells=kind == "ring")
            check([*resident, *readers(kind, memory)], genuine)
        successor, *_, late = writer(kind, memory), *readers(kind, memory)
        seq = successor.put(b"new", 5)
        assert list(read(late)) == [(seq, 5, b"new")]


def test_a_slice_of_a_file_is_that_of_its_bytes(fds: list[int]) -> None:
    fds.append(fd := os.memfd_create("file"))
    view, data = FileView(fd), bytes(range(200))
    view[0 : len(data)] = data
    view[70:80] = b"0123456789"
    data = data[:70] + b"0123456789" + data[80:]
    for where in (slice(0, 64), slice(64, 128), slice(70, 80), slice(100, 300)):
        assert view[where] == data[where]


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_was_cut_is_read_as_far_as_it_goes(kind: str, fds: list[int]) -> None:
    size = AT + KINDS[kind] * SIZE
    fds.append(fd := os.memfd_create("cut"))
    os.ftruncate(fd, size)
    view, dice = FileView(fd), random.Random(kind)
    genuine = written(kind, view, dice)
    image, resident = os.pread(fd, size, 0), readers(kind, view)
    for left in (*range(0, size, 7), 4 * size):
        os.ftruncate(fd, left)
        check([*resident, *readers(kind, view)], genuine)
        os.ftruncate(fd, size)  # zeros where its bytes were
        check(resident, genuine)
        os.pwrite(fd, image, 0)
    assert any(list(read(reader)) for reader in readers(kind, view))
