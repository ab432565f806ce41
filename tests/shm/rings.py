"""Rings for tests: made, written, read, spoiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from failstop.shm import cell
from failstop.shm.cell import RingReader, RingWriter, cell_bytes

from .memory import Death, Memory, genuine, payload_of, time_of

if TYPE_CHECKING:
    from failstop.shm.cell import View

SEED = cell.seed("test.ring", 1)
AT = 128
CAPACITY = 40
CELLS = 8
SIZE = cell_bytes(CAPACITY)


def ring_memory(cells: int = CELLS, capacity: int = CAPACITY) -> Memory:
    return Memory(AT + cells * cell_bytes(capacity))


def writer_of(view: View, cells: int = CELLS, capacity: int = CAPACITY) -> RingWriter:
    return RingWriter(view, AT, capacity, cells, SEED)


def reader_of(view: View, cells: int = CELLS, capacity: int = CAPACITY, *, from_oldest: bool = False) -> RingReader:
    return RingReader(view, AT, capacity, cells, SEED, from_oldest=from_oldest)


def ring(cells: int = CELLS) -> tuple[Memory, RingWriter, RingReader]:
    memory = ring_memory(cells)
    return memory, writer_of(memory, cells), reader_of(memory, cells)


def put(writer: RingWriter, count: int = 1, size: int = CAPACITY) -> None:
    for _ in range(count):
        seq = writer.seq + 1
        assert writer.put(payload_of(seq, size), time_of(seq)) == seq


def drain(reader: RingReader) -> list[int]:
    """The numbers of all entries that wait; each must be genuine."""
    found = []
    while entry := reader.next():
        assert genuine(entry)
        found.append(entry[0])
    return found


def place(seq: int) -> int:
    return AT + seq % CELLS * SIZE


def damage(memory: Memory, seq: int, *, zero: bool = False) -> None:
    at = place(seq)
    if zero:
        memory.data[at : at + SIZE] = bytes(SIZE)
    else:
        memory.data[at + 30] ^= 0x40


def die_writing(memory: Memory, writer: RingWriter, cut: int = 30) -> RingWriter:
    """The writer dies after `cut` bytes of its next entry; returns its successor."""
    memory.left = cut
    with pytest.raises(Death):
        put(writer)
    return writer_of(memory)
