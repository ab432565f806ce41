"""Cells hold all values in shared memory that are wider than one word. This file also accesses the bytes of a segment.

    crc32 u32 | length u32 | seq u64 | t_mono_ns u64 | payload[length]

The CRC covers the length, seq, t_mono_ns and payload. It is seeded with the record's name and the run's incarnation, so
bytes of a different record or of a dead run never pass the check.

To write a cell: (1) build the whole cell privately, (2) pass a barrier, (3) store it with ONE slice assignment.
To read a cell: (1) take ONE slice copy, (2) check the private copy, (3) use only the private copy.

A reader may copy a mixture of old and new bytes, for example if the writer dies in the middle of a write. The CRC of
the copy shows this, in whatever order the processor loads and stores the bytes. Never use `struct.pack_into` on shared
memory: it writes zeros first, and a reader would see them.

A Latest record consists of two cells that are written in turn. The newest whole cell has the record's value. A Ring
record is a stream of entries, one in each cell.
"""

from __future__ import annotations

import os
import struct
from time import monotonic_ns
from zlib import crc32

from failstop.shm.words import LINE_BYTES, Barrier

CELL_HEADER_BYTES = 24
_HEAD = struct.Struct("<IIQQ")
_BODY = struct.Struct("<IQQ")
_CRC = struct.Struct("<I")

Entry = tuple[int, int, bytes]
"""An entry: its number (from 1), its time (CLOCK_MONOTONIC, ns), and its payload."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Protocol

    class View(Protocol):
        """Memory as a reader or writer uses it. A reader copies one slice, and a writer assigns one slice."""

        def __getitem__(self, where: slice, /) -> bytes: ...

        def __setitem__(self, where: slice, data: bytes, /) -> None: ...


class FileView:
    """A file that is used like memory, through pread and pwrite. Use it for all files that clients may write.

    If a client truncates the file, a read returns too few bytes, and check() rejects them. If the file were mapped, a
    SIGBUS would kill the reader.
    """

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def __getitem__(self, where: slice) -> bytes:
        return os.pread(self.fd, where.stop - where.start, where.start)

    def __setitem__(self, where: slice, data: bytes) -> None:
        os.pwrite(self.fd, data, where.start)


class PayloadTooLarge(ValueError):
    """The payload is larger than the layout allows for its record."""


def seed(record: str, incarnation: int) -> int:
    """The CRC seed for the cells of a record in one run. `record`: the record's name, as `segment.record`.
    `incarnation`: the random number of the run."""
    return crc32(record.encode(), crc32(incarnation.to_bytes(8, "little")))


def build(seq: int, t_ns: int, payload: bytes, crc_seed: int, capacity: int) -> bytes:
    """Return the bytes of a cell, ready for one slice assignment. `seq` starts at 1, because 0 marks a cell that was
    never written. Raises PayloadTooLarge."""
    if len(payload) > capacity:
        raise PayloadTooLarge(f"payload of {len(payload)} bytes, the record holds {capacity}")
    body = _BODY.pack(len(payload), seq, t_ns) + payload
    return _CRC.pack(crc32(body, crc_seed)) + body


def check(raw: bytes, crc_seed: int) -> Entry | None:
    """Return (seq, t_mono_ns, payload) from a private copy of a cell, or None if the cell is not whole."""
    if len(raw) < CELL_HEADER_BYTES:
        return None
    crc, length, seq, t_ns = _HEAD.unpack_from(raw)
    end = CELL_HEADER_BYTES + length
    if seq == 0 or end > len(raw) or crc32(raw[4:end], crc_seed) != crc:
        return None
    return seq, t_ns, raw[CELL_HEADER_BYTES:end]


def cell_bytes(capacity: int) -> int:
    """The size of a cell for a payload of at most `capacity` bytes. Cells fill whole 64-byte lines, so no two cells
    share a line."""
    return -(-(CELL_HEADER_BYTES + capacity) // LINE_BYTES) * LINE_BYTES


class _Cells:
    """All cells of one record."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        self._view = view
        self._at = offset
        self._capacity = capacity
        self._cells = cells
        self._size = cell_bytes(capacity)
        self._seed = crc_seed

    def _slice(self, seq: int) -> slice:
        """Where the entry with the number `seq` is in the segment."""
        at = self._at + seq % self._cells * self._size
        return slice(at, at + self._size)

    def _last(self) -> int:
        """The number of the newest whole entry, or 0 if the record has none."""
        return max(self._whole(), default=0)

    def _whole(self) -> list[int]:
        """The numbers of all whole entries, from one copy of the record. Too slow for frequent use."""
        raw, size = self._view[self._at : self._at + self._cells * self._size], self._size
        seqs = enumerate(struct.iter_unpack(f"<8xQ{size - 16}x", raw[: len(raw) // size * size]))
        return [n for i, (n,) in seqs if n % self._cells == i and check(raw[i * size : (i + 1) * size], self._seed)]


class LatestReader(_Cells):
    """Reads the newest whole value of a record. Reading an unchanged record takes only a third of the time."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._where = slice(offset, offset + cells * self._size)
        self._seen = 0
        self._raw = b""
        """The bytes that the previous read() copied. `_known` is the value that they contain."""
        self._known: Entry | None = None

    def read(self) -> Entry | None:
        """Return (seq, t_mono_ns, payload) of the newest whole value, or None if there is none."""
        raw = self._view[self._where]
        if raw == self._raw:
            return self._known
        entry = self._newest(raw)
        # If two writes happen during the copy, the copy may hold no whole value, or only one older than a value that
        # was returned before. Then copy again.
        for _ in range(2):
            if (entry and entry[0] >= self._seen) or not raw.strip(b"\0"):
                break
            Barrier()()  # without it, this copy's loads may be as old as those of the previous copy
            raw = self._view[self._where]
            entry = self._newest(raw)
        self._raw, self._known = raw, entry
        self._seen = entry[0] if entry else self._seen
        return entry

    def _newest(self, raw: bytes) -> Entry | None:
        found = check(raw[: self._size], self._seed), check(raw[self._size :], self._seed)
        return max(filter(None, found), default=None)


class _Writer(_Cells):
    """The only writer of a record. A writer that replaces a dead one continues after the newest whole entry. It
    overwrites a half-written cell, so the newest whole entry stays readable."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._barrier = Barrier()
        self.seq = self._last()
        """The number of the newest entry, or 0 if the record has none."""

    def put(self, payload: bytes, t_ns: int | None = None) -> int:
        """Publish an entry and return its number. Raises PayloadTooLarge, and then publishes nothing."""
        seq = self.seq + 1
        data = build(seq, monotonic_ns() if t_ns is None else t_ns, payload, self._seed, self._capacity)
        at = self._slice(seq).start
        self._barrier()
        self._view[at : at + len(data)] = data
        self.seq = seq
        return seq


class LatestWriter(_Writer):
    """Publishes the values of a Latest record. Readers need only the newest value."""

    write = _Writer.put


class RingWriter(_Writer):
    """Appends entries in order, for any number of readers. Entry `n` is in cell `n % cells`. The writer and the readers
    share no head, no tail and no lock, and no reader stores anything in shared memory. A reader that sees an entry also
    sees everything that the writer stored before it."""

    def put_all(self, data: bytes, t_ns: int | None = None) -> None:
        """Publish bytes of any length, split into as many entries as needed."""
        for at in range(0, len(data), self._capacity):
            self.put(data[at : at + self._capacity], t_ns)


class RingReader(_Cells):
    """One reader's position in a ring. `lost` counts the entries that were overwritten before this reader read them.

    To read entry n, the reader copies the cell n % cells with one slice, and checks the copy:

        seq is n                       -> the copy is entry n
        seq is below n, or never used  -> entry n is not published yet
        seq is above n                 -> entry n is overwritten. Continue with the oldest entry that can be whole
        the copy is not whole          -> entry n is being written, or it is damaged. If a later entry is whole, entry n
                                          is lost. Continue with the oldest whole entry after entry n
    """

    def __init__(
        self, view: View, offset: int, capacity: int, cells: int, crc_seed: int, *, from_oldest: bool = False
    ) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._blank = bytes(self._size)
        self.lost = 0
        self._old = b""
        """The bytes of the next cell at the last look, if the cell was blank or held an older entry then. While the
        bytes stay the same, the reader does not check them again."""
        last = self._last()
        self._await(max(1, last - cells + 1) if from_oldest else last + 1)

    def next(self) -> Entry | None:
        """Return the next entry (seq, t_mono_ns, payload) in order, or None if no new entry is published."""
        laps = 0
        while True:
            raw = self._view[self._where]
            if raw == self._old:
                return None
            entry = self._check(raw)
            if entry is None:
                if raw == self._blank and self._next <= self._cells:
                    self._old = raw
                    return None
                if not self._pass_damage():
                    return None
                continue
            if entry[0] < self._next:
                self._old = raw
                return None
            if entry[0] > self._next:
                # Continue with the oldest entry that can still be whole, `cells - 1` before this one. In a ring at rest
                # that takes fewer steps than there are cells. But a writer at full speed overwrites the oldest entry
                # again and again. So after many laps, each further lap goes back half as far, in the end to this entry.
                halvings = max(0, laps - self._cells)
                self._resume(entry[0] - (self._cells - 1 >> halvings))
                laps += 1
            if entry[0] == self._next:
                self._await(entry[0] + 1)
                return entry

    def _await(self, seq: int) -> None:
        self._next = seq
        self._where = self._slice(seq)
        self._old = b""

    def _check(self, raw: bytes) -> Entry | None:
        """The entry in a copy of the next cell. None if the copy is not whole, or if an entry with its number belongs
        in a different cell."""
        entry = check(raw, self._seed)
        if entry and (entry[0] - self._next) % self._cells:
            return None
        return entry

    def _resume(self, seq: int) -> None:
        self.lost += seq - self._next
        self._await(seq)

    def _pass_damage(self) -> bool:
        """Skip a damaged cell if a later entry is whole. Returns False if the reader must wait, because the next entry
        may still be written to the cell. Returns True if the reader must look again.

        If a damaged cell were not skipped, it would hide the entries after it until the writer has gone once around the
        ring.
        """
        later = [seq for seq in self._whole() if seq > self._next]
        if not later:
            return False
        # The next entry and later ones may have been published during the search, so look once more.
        Barrier()()
        if self._check(self._view[self._where]) is None:
            self._resume(min(later))
        return True
