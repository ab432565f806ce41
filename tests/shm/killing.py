"""Kill writers in mid-write, thousands of times, and read all the while: run as a program, the result is one JSON line.

A small process of its own, because a fork of the test runner costs more than the kill. Each round forks a writer that
writes flat out; this process reads from its first record on, kills it at a random moment, and looks at what it left.

`control` takes the protection away, to prove that this would be seen: the check compares no CRC, and the writer stores
header, payload and CRC one after the other.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import sys
import time

from failstop.shm import cell
from failstop.shm.cell import LatestReader, LatestWriter, RingReader, RingWriter, cell_bytes
from failstop.shm.words import Word

from .memory import exit_after, payload_of, time_of

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.cell import Entry, View

DELAY_NS = 300_000


def check_without_crc(raw: bytes, crc_seed: int) -> Entry | None:
    if len(raw) < cell.CELL_HEADER_BYTES:
        return None
    length = int.from_bytes(raw[4:8], "little")
    seq = int.from_bytes(raw[8:16], "little")
    t_ns = int.from_bytes(raw[16:24], "little")
    end = cell.CELL_HEADER_BYTES + length
    if seq == 0 or end > len(raw):
        return None
    return seq, t_ns, raw[cell.CELL_HEADER_BYTES : end]


class Separate:
    """A view that stores header, payload and CRC one after the other."""

    def __init__(self, view: View) -> None:
        self._view = view

    def __getitem__(self, where: slice) -> bytes:
        return self._view[where]

    def __setitem__(self, where: slice, data: bytes) -> None:
        at = where.start
        self._view[at + 4 : at + cell.CELL_HEADER_BYTES] = data[4 : cell.CELL_HEADER_BYTES]
        self._view[at + cell.CELL_HEADER_BYTES : where.stop] = data[cell.CELL_HEADER_BYTES :]
        self._view[at : at + 4] = data[:4]


class Case:
    """One record under fire: where it lies, and its reader and writer."""

    def __init__(self, kind: str, size: int, control: bool) -> None:
        self.kind, self.size = kind, size
        self.capacity, self.at, self.seed = size, 64, 4711
        self.cells = 2 if kind == "latest" else 4
        self.reads: View = mmap.mmap(-1, 64 + cell_bytes(size) * self.cells)
        self.writes: View = Separate(self.reads) if control else self.reads

    def writer(self) -> LatestWriter | RingWriter:
        if self.kind == "latest":
            return LatestWriter(self.writes, self.at, self.capacity, self.cells, self.seed)
        return RingWriter(self.writes, self.at, self.capacity, self.cells, self.seed)

    def reader(self, *, from_oldest: bool = False) -> LatestReader | RingReader:
        if self.kind == "latest":
            return LatestReader(self.reads, self.at, self.capacity, self.cells, self.seed)
        return RingReader(self.reads, self.at, self.capacity, self.cells, self.seed, from_oldest=from_oldest)

    def left_torn(self) -> int:
        size = cell_bytes(self.capacity)
        torn = 0
        for i in range(self.cells):
            raw = self.reads[self.at + i * size : self.at + (i + 1) * size]
            if any(raw[:24]) and not self.is_genuine(check_without_crc(raw, 0)):
                torn += 1
        return torn

    def is_genuine(self, entry: Entry | None) -> bool:
        """By the payload and time that belong to the number, and no CRC."""
        if entry is None:
            return False
        seq, t_ns, payload = entry
        right: bool = t_ns == time_of(seq) and payload == payload_of(seq, self.size_of(seq))
        return right

    def size_of(self, seq: int) -> int:
        """Payloads of several lengths, so that the lengths are torn too."""
        return self.size - seq % 3 * (self.size // 4)


def write_flat_out(case: Case, first: Word, ready: Word) -> None:
    """The child: take over as a successor and write until killed."""
    check = exit_after(20)
    writer = case.writer()
    put = writer.write if isinstance(writer, LatestWriter) else writer.put
    reader = case.reader()
    found = reader.read() if isinstance(reader, LatestReader) else None
    seq = (writer.seq if isinstance(writer, RingWriter) else found[0] if found else 0) + 1
    first.set(seq)
    while True:
        if put(payload_of(seq, case.size_of(seq)), time_of(seq)) != seq:
            os._exit(96)
        if not seq & 255:
            check()
        ready.set(1)
        seq += 1


class Watch:
    """The reader's account of what it saw."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.reader = case.reader()
        self.last = 0
        self.reads = 0
        self.accepted = 0
        self.torn = 0
        self.faults: list[str] = []

    def fault(self, text: str) -> None:
        """Note what must not be; in a control only the torn records count."""
        if len(self.faults) < 10:
            self.faults.append(text)

    def look(self) -> None:
        self.reads += 1
        if isinstance(self.reader, LatestReader):
            entry = self.reader.read()
            if entry is None:
                if self.last:
                    self.fault(f"no value after {self.last}")
                return
            if entry[0] < self.last:
                self.fault(f"{entry[0]} after {self.last}")
        else:
            lost = self.reader.lost
            entry = self.reader.next()
            if entry is None:
                return
            if entry[0] <= self.last or entry[0] - self.last - 1 != self.reader.lost - lost:
                self.fault(f"{entry[0]} after {self.last}, {self.reader.lost - lost} lost")
        self.accepted += 1
        self.last = entry[0]
        if not self.case.is_genuine(entry):
            self.torn += 1

    def look_at_what_is_left(self) -> int:
        """After a death: everything that can be read; returns the newest whole number."""
        if isinstance(self.reader, LatestReader):
            self.look()
            return self.last
        before = -1
        while before != self.accepted:
            before = self.accepted
            self.look()
        newest = 0
        late = self.case.reader(from_oldest=True)
        assert isinstance(late, RingReader)
        count = 0
        while entry := late.next():
            count += 1
            if newest and entry[0] != newest + 1:
                self.fault(f"left in the ring: {entry[0]} after {newest}")
            newest = entry[0]
            self.torn += not self.case.is_genuine(entry)
        if count < min(newest, self.case.cells) - 1:
            self.fault(f"only {count} entries left in the ring at {newest}")
        return newest


def one_kill(case: Case, watch: Watch, dice: random.Random, words: tuple[Word, Word], newest: int) -> tuple[int, int]:
    """Fork, read, kill, look; returns the newest number left and how many reads were made while the writer lived."""
    first, ready = words
    ready.set(0)
    pid = os.fork()
    if pid == 0:
        try:
            write_flat_out(case, first, ready)
        finally:
            os._exit(95)
    try:
        limit = time.monotonic() + 10
        before = watch.reads
        while not ready.get():
            watch.look()
            if time.monotonic() > limit:
                watch.fault("writer never ready")
                break
        end = time.monotonic_ns() + dice.randrange(DELAY_NS)
        while time.monotonic_ns() < end:
            watch.look()
    finally:
        os.kill(pid, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    during = watch.reads - before
    if status != -signal.SIGKILL:
        watch.fault(f"writer ended by itself: {status}")
    if first.get() != newest + 1:
        watch.fault(f"successor began at {first.get()}, newest whole was {newest}")
    left = watch.look_at_what_is_left()
    if left < watch.last:
        watch.fault(f"{left} left, though {watch.last} was seen")
    return left, during


def run(kind: str, size: int, kills: int, random_seed: int, control: bool) -> dict[str, object]:
    """Kill so many writers one after the other; returns the account."""
    if control:
        cell.check = check_without_crc
    case = Case(kind, size, control)
    memory, watch, dice = mmap.mmap(-1, 4096), Watch(case), random.Random(random_seed)
    newest = left_torn = during = 0
    for _ in range(kills):
        newest, reads = one_kill(case, watch, dice, (Word(memory, 0), Word(memory, 64)), newest)
        during += reads
        left_torn += bool(case.left_torn())
    seen = {"kills": kills, "written": newest, "reads_while_writing": during, "accepted": watch.accepted}
    return seen | {"torn_accepted": watch.torn, "kills_that_left_a_torn_cell": left_torn, "faults": watch.faults}


if __name__ == "__main__":
    _kind, _size, _kills, _seed, _control = sys.argv[1:]
    print(json.dumps(run(_kind, int(_size), int(_kills), int(_seed), _control == "control")))
