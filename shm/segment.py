"""Segments: pieces of shared memory with one writer each. A SegmentSpec says which records a segment has, and where
they are."""

from __future__ import annotations

import mmap

from failstop.data import Data
from failstop.shm import cell, owned
from failstop.shm.cell import FileView, LatestReader, LatestWriter, RingReader, RingWriter
from failstop.shm.futex import Futex
from failstop.shm.words import LINE_BYTES, Word

HEADER_BYTES = 128
"""The size of the cell at the start of every segment (messages/segments.py). Never change this size, because different
versions of failstop recognise each other by this cell."""


class Record(Data):
    """One record of a segment. `kind`: word, latest, ring or futexes. `readers`: the processes that read the record.
    `capacity`: the payload of one cell in bytes, or for futexes the size of the whole record. `cells`: 2 for latest."""

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
    """The specification of one segment: its name, its one writer, the mode of its file, and the offset of each
    record."""

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
    """A segment as this process reads or writes it. Most segments are mapped into memory. The client slots and the
    lifelines are accessed through pread and pwrite, because another process could truncate their files."""

    def __init__(self, spec: SegmentSpec, incarnation: int, mapped: mmap.mmap | None = None, fd: int = -1) -> None:
        self.spec = spec
        self.incarnation = incarnation
        self.mapped = mapped
        self.view: FileView | mmap.mmap = FileView(fd) if mapped is None else mapped
        self._fd = fd
        self._file = owned.inode_of(fd)

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
        """A word (a single u64). Raises TypeError if the segment is not mapped."""
        _, offset = self._place(name, "word")
        if self.mapped is None:
            raise TypeError(f"{self.spec.name}.{name}: words are only read through a mapping")
        return Word(self.mapped, offset)

    def latest_reader(self, name: str) -> LatestReader:
        return LatestReader(*self._cells(name, "latest"))

    def latest_writer(self, name: str) -> LatestWriter:
        """The writer of a Latest record. Only the segment's one writer (SegmentSpec.writer) may call this."""
        return LatestWriter(*self._cells(name, "latest"))

    def ring_reader(self, name: str, *, from_oldest: bool = False) -> RingReader:
        """A reader of a Ring record. If `from_oldest`, it starts with the oldest entry in the ring, otherwise with the
        next entry that is published."""
        return RingReader(*self._cells(name, "ring"), from_oldest=from_oldest)

    def ring_writer(self, name: str) -> RingWriter:
        """The writer of a Ring record. Only the segment's one writer (SegmentSpec.writer) may call this."""
        return RingWriter(*self._cells(name, "ring"))

    def futex(self, name: str, line: int = 0, *, write: bool = False) -> Futex:
        """The futex in one line of a record of futexes. `write`: True if a thread of this process will hold the futex,
        False if threads only wait for the holder's death. Raises TypeError if the segment is mapped, IndexError for a
        line that does not exist, and OSError."""
        record, offset = self._place(name, "futexes")
        if self._fd < 0:
            raise TypeError(f"{self.spec.name}.{name}: a futex needs the file")
        if not 0 <= line < record.capacity // LINE_BYTES:
            raise IndexError(f"{self.spec.name}.{name} has {record.capacity // LINE_BYTES} lines, none is {line}")
        return Futex(self._fd, offset + line * LINE_BYTES, write=write)

    def wipe(self) -> None:
        """Empty this client's slot, except for the record of goodbyes. If a goodbye were erased before the gate has
        read it, the gate would take a clean exit for a death."""
        at = HEADER_BYTES + self.spec.records["left"].size()
        self.view[at : self.spec.size] = bytes(self.spec.size - at)

    def fileno(self) -> int:
        """The descriptor of an unmapped segment, or -1 for a mapped one."""
        return self._fd

    def close(self) -> None:
        """Close the descriptor of an unmapped segment. A mapped segment is unmapped when its last word or reader is
        freed."""
        fd, self._fd = self._fd, -1
        if isinstance(self.view, FileView):
            self.view.fd = -1  # the number may be reused for another file, which this view must not reach
        owned.close(fd, self._file)
