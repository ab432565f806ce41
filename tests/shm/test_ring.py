"""Ring: order, what was lost counted exactly, deaths and damage passed, against a plain list."""

from __future__ import annotations

import pytest

from failstop.shm.cell import RingReader, RingWriter

from .memory import Memory, genuine
from .rings import (
    AT,
    CAPACITY,
    CELLS,
    SEED,
    SIZE,
    damage,
    die_writing,
    drain,
    place,
    put,
    reader_of,
    ring,
    ring_memory,
    writer_of,
)


def test_one_store_a_put_and_one_copy_a_look() -> None:
    memory, writer, reader = ring()
    memory.copies.clear()
    put(writer, 2)
    put(writer, 1, size=5)
    assert [(at, len(data)) for at, data in memory.stores] == [(place(1), 64), (place(2), 64), (place(3), 29)]
    assert memory.copies == []
    assert drain(reader) == [1, 2, 3]
    assert memory.copies == [slice(place(seq), place(seq) + SIZE) for seq in (1, 2, 3, 4)]


def test_an_idle_ring_costs_one_copy_a_look() -> None:
    """Looking through the whole ring is for damage only, not for a ring in which nothing is new."""
    memory, writer, reader = ring()
    for _ in range(3 * CELLS):
        memory.copies.clear()
        assert reader.next() is None
        assert len(memory.copies) == 1
        put(writer)
        assert drain(reader) == [writer.seq]


@pytest.mark.parametrize("size", [0, 1, CAPACITY - 1, CAPACITY, CAPACITY + 1, 3 * CAPACITY, 3 * CAPACITY + 1])
def test_bytes_of_any_length_come_whole_in_as_few_entries_as_hold_them(size: int) -> None:
    _, writer, reader = ring()
    data = bytes(range(size))
    writer.put_all(data, 77)
    found = list(iter(reader.next, None))
    assert b"".join(payload for _, _, payload in found) == data
    assert [(seq, t_ns) for seq, t_ns, _ in found] == [(seq, 77) for seq in range(1, -(-size // CAPACITY) + 1)]


@pytest.mark.parametrize("read", range(CELLS + 2))
def test_lapping_counts_exactly_what_was_lost(read: int) -> None:
    for ahead in (*range(1, 3 * CELLS + 2), 10 * CELLS):
        _, writer, reader = ring()
        put(writer, read)
        drained = drain(reader)
        reader_at, lost_before = (drained[-1] if drained else 0), reader.lost
        put(writer, ahead)
        found = drain(reader)
        assert found == list(range(max(reader_at, writer.seq - CELLS) + 1, writer.seq + 1))
        assert reader.lost - lost_before == found[0] - reader_at - 1 == max(0, ahead - CELLS)


@pytest.mark.parametrize("written", [0, 1, CELLS - 1, CELLS, CELLS + 1, 3 * CELLS + 5])
def test_where_readers_start(written: int) -> None:
    memory = ring_memory()
    writer = writer_of(memory)
    put(writer, written)
    latest, oldest = reader_of(memory), reader_of(memory, from_oldest=True)
    assert latest.next() is None
    assert drain(oldest) == list(range(max(1, written - CELLS + 1), written + 1))
    put(writer, 2)
    assert drain(latest) == drain(oldest) == [written + 1, written + 2]
    assert latest.lost == oldest.lost == 0
    assert RingReader(memory, AT, CAPACITY, CELLS, SEED).next() is None, "unless told"


@pytest.mark.parametrize("written", [0, 1, CELLS - 1, CELLS, CELLS + 3])
def test_a_death_at_every_byte_and_a_successor_goes_on(written: int) -> None:
    for cut in range(SIZE + 1):
        memory = ring_memory()
        writer = writer_of(memory)
        reader = reader_of(memory)
        put(writer, written)
        drain(reader)
        lost = reader.lost
        successor = die_writing(memory, writer, cut)
        whole = written + (cut == SIZE)
        assert successor.seq == whole
        assert drain(reader) == [written + 1] * (whole - written)
        put(successor, 3)
        assert drain(reader) == [whole + 1, whole + 2, whole + 3]
        assert reader.lost == lost


def test_a_death_in_mid_write_costs_a_reader_a_lap_behind_the_oldest_entry_alone() -> None:
    """Its very cell is torn: all the others must be read before a successor has written anything."""
    memory, writer, reader = ring()
    put(writer, CELLS)
    die_writing(memory, writer)
    assert drain(reader) == drain(reader_of(memory, from_oldest=True)) == list(range(2, CELLS + 1))
    assert reader.lost == 1


@pytest.mark.parametrize(("zero", "first"), [(False, 0), (False, 2 * CELLS + 3), (True, 2 * CELLS + 3)])
@pytest.mark.parametrize("spoiled", [(2,), (1,), (2, 3), (1, 2, 3), (2, 4), (1, 2, 3, 4, 5)])
def test_damage_loses_only_what_was_damaged(spoiled: tuple[int, ...], first: int, zero: bool) -> None:
    """A damaged entry must not hold up the stops behind it for a lap of the ring."""
    memory = ring_memory()
    writer = writer_of(memory)
    put(writer, first)
    reader = reader_of(memory)
    put(writer, 6)
    for seq in spoiled:
        damage(memory, first + seq, zero=zero)
    assert drain(reader) == [first + seq for seq in range(1, 7) if seq not in spoiled]
    assert reader.lost == len(spoiled)
    put(writer, CELLS)
    assert drain(reader) == list(range(first + 7, first + 7 + CELLS))
    assert reader.lost == len(spoiled)


def test_a_zeroed_cell_of_the_first_lap_holds_up_no_longer_than_that_lap() -> None:
    """The one damage that looks like a cell never used; the next lap ends it, and it is counted."""
    memory, writer, reader = ring()
    put(writer, 4)
    damage(memory, 2, zero=True)
    assert drain(reader) == [1]
    put(writer, CELLS)
    assert drain(reader) == list(range(5, 5 + CELLS))
    assert reader.lost == 3


def test_damage_to_the_newest_waits_for_what_comes() -> None:
    memory, writer, reader = ring()
    put(writer, CELLS + 3)
    drain(reader)
    lost = reader.lost
    put(writer, 1)
    damage(memory, writer.seq)
    assert reader.next() is None
    assert reader.lost == lost
    put(writer, 1)
    assert drain(reader) == [writer.seq]
    assert reader.lost == lost + 1


def test_a_cell_copied_over_another_is_damage() -> None:
    for source in range(1, 7):
        for target in range(2, 6):
            if source == target:
                continue
            memory, writer, reader = ring()
            put(writer, 6)
            memory.data[place(target) : place(target) + SIZE] = memory.data[place(source) : place(source) + SIZE]
            assert drain(reader) == [seq for seq in range(1, 7) if seq != target]
            assert reader.lost == 1
            assert writer_of(memory).seq == 6


def test_a_successor_does_not_go_on_after_an_entry_in_the_wrong_cell() -> None:
    memory = ring_memory()
    put(writer_of(memory), 6)
    memory.data[place(2) : place(2) + SIZE] = memory.data[place(6) : place(6) + SIZE]
    damage(memory, 6)
    assert writer_of(memory).seq == 5
    assert writer_of(memory).seq == 5


def test_published_while_the_ring_is_looked_through_is_not_lost() -> None:
    """The reader meets a cell in mid-write, and the writer goes on while it looks for damage."""
    for at_copy in range(2, 2 * CELLS + 3):
        memory = ring_memory()
        writer = writer_of(memory)
        put(writer, CELLS + 3)
        reader = reader_of(memory)
        torn = Memory(0)
        torn.data = memory.data
        damage(memory, CELLS + 4)  # as it is while the writer stores it
        copies = 0

        def later(at_copy: int = at_copy, writer: RingWriter = writer) -> None:
            nonlocal copies
            copies += 1
            if copies == at_copy:
                put(writer, 3)

        memory.before_copy = later
        found = drain(reader)
        memory.before_copy = lambda: None
        found += drain(reader)
        if copies < at_copy:
            continue
        assert found == [CELLS + 4, CELLS + 5, CELLS + 6]
        assert reader.lost == 0


@pytest.mark.parametrize("puts", [1, 2, 3, 7])
@pytest.mark.parametrize("cells", [1, 2, 3, 8, 64])
def test_a_writer_as_fast_as_the_reader_cannot_hold_it_in_a_chase(cells: int, puts: int) -> None:
    """While the reader copies one cell the writer overwrites the oldest ones: one call must still come to an end."""
    memory, writer, reader = ring(cells)
    put(writer, 5 * cells)
    memory.before_copy = lambda: put(writer, puts)
    last = 0
    for _ in range(20):
        memory.copies.clear()
        lost = reader.lost
        entry = reader.next()
        # A writer that laps a small ring between two copies leaves nothing to read, but must not keep the caller.
        assert len(memory.copies) <= 2 * cells + 10
        if entry is None:
            continue
        assert genuine(entry)
        assert entry[0] - last - 1 == reader.lost - lost
        last = entry[0]
    assert last > 0 or puts >= cells
