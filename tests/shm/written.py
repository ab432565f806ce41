"""A segment with a history in every record, for tests that damage its file."""

from __future__ import annotations

import os
import random
from typing import TYPE_CHECKING

from failstop.messages import segments
from failstop.messages.layout import CLIENT_SLOTS, SEGMENT_BY_NAME
from failstop.shm.cell import LatestReader, RingReader
from failstop.shm.segment import Segment, SegmentSpec

from .memory import payload_of, time_of
from .segments import RUN, path_of

if TYPE_CHECKING:
    from failstop.shm.cell import Entry

CLIENT_NAMES = [f"client.{i}" for i in range(CLIENT_SLOTS)]


class Written:
    """A segment with a history in every record, the readers on it, and what may be read from each."""

    def __init__(self, instance: str, of: str, dice: random.Random) -> None:
        self.spec: SegmentSpec = SEGMENT_BY_NAME[of]
        self.dice = dice
        segments.create(instance, of, RUN).close()
        self.instance = instance
        self.client = of in CLIENT_NAMES
        writes = self.attached(write=True)
        self.genuine: dict[str, set[Entry]] = {}
        for record in self.spec.records.values():
            if record.kind == "word":
                writes.word(record.name).set(dice.getrandbits(64))
                continue
            if record.kind == "futexes":
                continue
            self.genuine[record.name] = found = set()
            put = (
                writes.latest_writer(record.name).write
                if record.kind == "latest"
                else writes.ring_writer(record.name).put
            )
            for seq in range(1, record.cells + 6):
                payload = payload_of(seq, dice.randrange(record.capacity + 1))
                assert put(payload, time_of(seq)) == seq
                found.add((seq, time_of(seq), payload))
        writes.close()
        self.reads = self.attached(write=False)
        with open(path_of(instance, of), "rb") as file:
            self.image = file.read()
        self.fd = os.open(path_of(instance, of), os.O_RDWR)
        self.seen = 0

    def attached(self, *, write: bool) -> Segment:
        index = int(self.spec.name.rpartition(".")[2]) if self.client else -1
        if not self.client:
            return segments.attach(self.instance, self.spec.name, RUN, write=write)
        if write:
            return segments.attach(self.instance, f"client.{index}", RUN, write=True)
        return segments.read_client_slot(self.instance, index, RUN)

    def close(self) -> None:
        os.close(self.fd)
        self.reads.close()

    def readers(self) -> dict[str, list[LatestReader | RingReader]]:
        """A reader of each kind for each record."""
        found: dict[str, list[LatestReader | RingReader]] = {}
        for record in self.spec.records.values():
            if record.kind == "latest":
                found[record.name] = [self.reads.latest_reader(record.name)]
            elif record.kind == "ring":
                found[record.name] = [
                    self.reads.ring_reader(record.name, from_oldest=oldest) for oldest in (True, False)
                ]
        return found

    def read_all(self, readers: dict[str, list[LatestReader | RingReader]]) -> None:
        """Read every record to its end: whatever comes out was written to that record."""
        for name, several in readers.items():
            for reader in several:
                if isinstance(reader, LatestReader):
                    entry = reader.read()
                    assert entry is None or entry in self.genuine[name]
                    self.seen += entry is not None
                    continue
                last = 0
                for _ in range(self.spec.records[name].cells + 1):
                    entry = reader.next()
                    if entry is None:
                        break
                    assert entry in self.genuine[name]
                    assert entry[0] > last
                    last = entry[0]
                    self.seen += 1
                assert reader.next() is None
        for record in self.spec.records.values():
            if record.kind == "word" and not self.client:
                assert 0 <= self.reads.word(record.name).get() < 2**64

    def span(self) -> tuple[int, int]:
        """A random place, more often a small one."""
        size = min(self.spec.size, 1 << self.dice.randrange(0, 17))
        at = self.dice.randrange(self.spec.size - size + 1)
        return at, size

    def scribble(self) -> None:
        """One of many ways to spoil the segment."""
        at, size = self.span()
        way = self.dice.randrange(7)
        if way == 0:
            data = self.dice.randbytes(size)
        elif way == 1:
            data = bytes(size)
        elif way == 2:
            data = b"\xff" * size
        elif way == 3:
            data = bytes([self.image[at] ^ 1 << self.dice.randrange(8)])
        elif way == 4:  # bytes from elsewhere in the same segment, records and all
            source = self.dice.randrange(self.spec.size - size + 1)
            data = self.image[source : source + size]
        elif way == 5:  # the same by lines, so that whole cells move
            at, size = at // 64 * 64, max(64, size // 64 * 64)
            source = self.dice.randrange(self.spec.size // 64) * 64
            data = self.image[source : source + size]
        else:
            at, data = 0, self.dice.randbytes(self.spec.size)
        os.pwrite(self.fd, data[: self.spec.size - at], at)

    def restore(self) -> None:
        os.ftruncate(self.fd, self.spec.size)
        os.pwrite(self.fd, self.image, 0)
