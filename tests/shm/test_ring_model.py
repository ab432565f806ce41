"""Ring: any series of writes, deaths and readers against a plain list, and writers at full speed."""

from __future__ import annotations

import mmap
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, rule

from failstop.shm import cell
from failstop.shm.cell import RingReader, RingWriter, cell_bytes
from tests.support.amounts import amount
from tests.support.children import Child

from .memory import Death, exit_after, genuine, payload_of, time_of
from .rings import AT, CAPACITY, SEED, SIZE, reader_of, ring_memory, writer_of

if TYPE_CHECKING:
    from failstop.shm.cell import Entry


class RingModel(RuleBasedStateMachine):
    """Writers that put, die and are followed, readers that come and read: against a list of what was wholly put."""

    readers: Bundle[tuple[RingReader, list[int]]] = Bundle("readers")

    @initialize(cells=st.sampled_from([1, 2, 3, 8]))
    def start(self, cells: int) -> None:
        self.cells = cells
        self.memory = ring_memory(cells)
        self.writer = writer_of(self.memory, cells)
        self.put: list[bytes] = []
        self.torn = False  # the cell of the next entry, which was that of the oldest, is torn

    @rule(payloads=st.lists(st.binary(max_size=CAPACITY), min_size=1, max_size=12))
    def append(self, payloads: list[bytes]) -> None:
        for payload in payloads:
            self.put.append(payload)
            assert self.writer.put(payload, len(payload)) == len(self.put)
        self.torn = False

    @rule(payload=st.binary(max_size=CAPACITY), share=st.floats(0, 1))
    def die(self, payload: bytes, share: float) -> None:
        seq = len(self.put) + 1
        data = cell.build(seq, 77, payload, SEED, CAPACITY)
        at = AT + seq % self.cells * SIZE
        before = bytes(self.memory.data[at : at + SIZE])
        self.memory.left = int(len(data) * share)
        with pytest.raises(Death):
            self.writer.put(payload, 77)
        after = bytes(self.memory.data[at : at + SIZE])
        if after[: len(data)] == data:
            self.put.append(payload)
            self.torn = False
        elif after != before:
            self.torn = True
        self.writer = writer_of(self.memory, self.cells)
        # With a lone cell a torn one leaves nothing to tell a successor how far its predecessor was.
        if self.cells == 1 and self.torn:
            self.put_lone_again(before)
        assert self.writer.seq == len(self.put)

    def put_lone_again(self, before: bytes) -> None:
        self.memory.data[AT : AT + SIZE] = before
        self.writer = writer_of(self.memory, 1)
        self.torn = False

    @rule()
    def successor(self) -> None:
        self.writer = writer_of(self.memory, self.cells)
        assert self.writer.seq == len(self.put)

    @rule(target=readers, from_oldest=st.booleans())
    def reader(self, from_oldest: bool) -> tuple[RingReader, list[int]]:
        reader = reader_of(self.memory, self.cells, from_oldest=from_oldest)
        last = len(self.put)
        return reader, [max(1, last - self.cells + 1) if from_oldest else last + 1]

    @rule(which=readers, count=st.integers(1, 12))
    def read(self, which: tuple[RingReader, list[int]], count: int) -> None:
        reader, model = which
        for _ in range(count):
            lost = reader.lost
            entry: Entry | None = reader.next()
            last, at = len(self.put), model[0]
            oldest = max(1, last - self.cells + 1)
            if self.torn and last >= self.cells:
                oldest += 1
            expected = max(at, oldest)
            if expected > last:
                assert entry is None
                return
            assert entry is not None
            assert entry[0] == expected
            assert entry[2] == self.put[expected - 1]
            assert reader.lost - lost == expected - at
            model[0] = expected + 1


TestRingModel = RingModel.TestCase


TestRingModel.settings = settings(max_examples=amount(60, 1000), stateful_step_count=40, deadline=None)


ENTRIES = amount(600, 20_000)


def flat_out(writer: RingWriter, size: int) -> Callable[[object, object], None]:
    def work(send: object, wait: object) -> None:
        check = exit_after(30)
        while True:
            seq = writer.seq + 1
            writer.put(payload_of(seq, size), time_of(seq))
            if seq % 1024 == 0:
                check()

    return work


def read_all_the_while(reader: RingReader, size: int, enough: int, pause: int) -> tuple[int, int]:
    """Read until enough entries were seen; returns how many, and how many were lost."""
    seen = last = 0
    limit = time.monotonic() + 20
    first_lost = reader.lost
    while seen < enough:
        assert time.monotonic() < limit
        lost = reader.lost
        entry = reader.next()
        if entry is None:
            continue
        assert genuine(entry, size)
        assert entry[0] > last
        if last:
            assert entry[0] - last - 1 == reader.lost - lost
        last = entry[0]
        seen += 1
        if pause and seen % pause == 0:
            for _ in range(20_000):
                pass
    return seen, reader.lost - first_lost


@pytest.mark.parametrize(("capacity", "cells", "pause"), [(40, 8, 0), (40, 8, 16), (320, 64, 100), (16384, 4, 3)])
def test_a_writer_at_full_speed(capacity: int, cells: int, pause: int) -> None:
    memory = mmap.mmap(-1, AT + cells * cell_bytes(capacity))
    with Child(flat_out(writer_of(memory, cells, capacity), capacity)):
        reader = reader_of(memory, cells, capacity)
        seen, lost = read_all_the_while(reader, capacity, ENTRIES, pause)
        if pause:
            assert lost > 0, "the reader was to be lapped"
        late = reader_of(memory, cells, capacity, from_oldest=True)
        read_all_the_while(late, capacity, 50, 0)
    assert seen == ENTRIES
