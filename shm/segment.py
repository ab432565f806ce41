"""Segments: shared memory with one writer, and the records that its specification places in it."""

from __future__ import annotations

import mmap
import os

from failstop.data import Data
from failstop.shm import cell
from failstop.shm.cell import FileView, LatestReader, LatestWriter, RingReader, RingWriter
from failstop.shm.futex import Futex
from failstop.shm.words import LINE_BYTES, Word

HEADER_BYTES = 128
"""The size of the cell with which every segment starts (messages/segments.py). Never change it, because versions
recognise each other by it."""


class Record(Data):
    """One record: its kind (word, latest, ring, futexes), payload capacity in bytes, cells (rings), readers."""

    kind: str
    name: str
    readers: str
    capacity: int = 8
    cells: int = 1

    def size(self) -> int:
        """How many bytes the record takes in its segment."""
        if self.kind == "word":
            return LINE_BYTES
        if self.kind == "futexes":
            return self.capacity
        return cell.cell_bytes(self.capacity) * self.cells


class SegmentSpec:
    """One segment: its name, its one writer, the mode of its file, and where each record lies in it."""

    def __init__(self, name: str, writer: str, mode: int, records: tuple[Record, ...]) -> None:
        self.name = name
        self.writer = writer
        self.mode = mode
        self.records = {record.name: record for record in records}
        self.offsets: dict[str, int] = {}
        at = HEADER_BYTES
        for record in records:
            self.offsets[record.name] = at
            at += record.size()
        self.size = (at + 4095) // 4096 * 4096


class Segment:
    """One segment as this process sees it: mapped (its own, or read-only), or through pread for client segments."""

    def __init__(self, spec: SegmentSpec, incarnation: int, mapped: mmap.mmap | None = None, fd: int = -1) -> None:
        self.spec = spec
        self.incarnation = incarnation
        self.mapped = mapped
        self.view: FileView | mmap.mmap = FileView(fd) if mapped is None else mapped
        self._fd = fd

    def _place(self, name: str, kind: str) -> tuple[Record, int]:
        record = self.spec.records[name]
        if record.kind != kind:
            raise TypeError(f"{self.spec.name}.{name} is a {record.kind}, not a {kind}")
        return record, self.spec.offsets[name]

    def _cells(self, name: str, kind: str) -> tuple[FileView | mmap.mmap, int, int, int, int]:
        record, offset = self._place(name, kind)
        seed = cell.seed(f"{self.spec.name}.{name}", self.incarnation)
        return self.view, offset, record.capacity, record.cells, seed

    def word(self, name: str) -> Word:
        """A word, which is a single u64. Only in mapped segments."""
        _, offset = self._place(name, "word")
        if self.mapped is None:
            raise TypeError(f"{self.spec.name}.{name}: words are only read through a mapping")
        return Word(self.mapped, offset)

    def latest_reader(self, name: str) -> LatestReader:
        return LatestReader(*self._cells(name, "latest"))

    def latest_writer(self, name: str) -> LatestWriter:
        """The writer of a Latest record. Only the segment's declared writer may call this."""
        return LatestWriter(*self._cells(name, "latest"))

    def ring_reader(self, name: str, *, from_oldest: bool = False) -> RingReader:
        """The reader of a Ring record. It starts at the oldest entry that is still there, or at the next one to
        come."""
        return RingReader(*self._cells(name, "ring"), from_oldest=from_oldest)

    def ring_writer(self, name: str) -> RingWriter:
        """The writer of a Ring record. Only the segment's declared writer may call this."""
        return RingWriter(*self._cells(name, "ring"))

    def futex(self, name: str, line: int = 0, *, write: bool = False) -> Futex:
        """A line on which to wait for a death or, with `write`, which to hold. Only in unmapped segments. Raises
        OSError."""
        record, offset = self._place(name, "futexes")
        if self._fd < 0:
            raise TypeError(f"{self.spec.name}.{name}: a futex needs the file")
        if not 0 <= line < record.capacity // LINE_BYTES:
            raise IndexError(f"{self.spec.name}.{name} has {record.capacity // LINE_BYTES} lines, none is {line}")
        return Futex(self._fd, offset + line * LINE_BYTES, write=write)

    def wipe(self) -> None:
        """Empty a client's own slot, except for the goodbyes: a goodbye that the gate has not seen would look like a
        death."""
        at = HEADER_BYTES + self.spec.records["left"].size()
        self.view[at : self.spec.size] = bytes(self.spec.size - at)

    def fileno(self) -> int:
        """The descriptor of an unmapped segment; -1 for a mapped one."""
        return self._fd

    def close(self) -> None:
        """Close the descriptor of an unmapped segment. A mapping ends when its last word or reader is freed."""
        fd, self._fd = self._fd, -1
        if isinstance(self.view, FileView):
            self.view.fd = -1  # the number may soon name another file, which a writer of this view must not reach
        if fd >= 0:
            os.close(fd)
