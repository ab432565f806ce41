"""Ring: any series of writes, deaths and readers against a plain list, and writers at full speed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, rule

from failstop.shm import cell
from failstop.shm.cell import RingReader
from tests.support.amounts import amount

from .memory import Death
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
