"""Cells: all values in shared memory that are wider than one word, and how a segment's bytes are accessed.

    crc32 u32 | length u32 | seq u64 | t_mono_ns u64 | payload[length]

The CRC covers everything after it and is seeded with the record's name and the run's incarnation, so bytes of another
record, or of a dead run, never pass as this one's.

Writing: (1) build the whole cell privately, (2) a barrier, (3) store it with ONE slice assignment.
Reading: (1) take ONE slice copy, (2) check the private copy, (3) use nothing but that copy.

Integrity then needs no memory ordering: whatever mixture of old and new bytes a reader sees, even after a death in the
middle of a write, the CRC of the private copy decides. `struct.pack_into` is never used on shared memory, because a
reader would see its zeros.

A Latest is two cells, written in turn: the newest whole value counts. A Ring is a stream of entries.
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
"""An entry: its number, its time (CLOCK_MONOTONIC, ns), and its payload."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Protocol

    class View(Protocol):
        """Memory, as a reader or writer uses it: one slice is copied out, or one slice is assigned."""

        def __getitem__(self, where: slice, /) -> bytes: ...

        def __setitem__(self, where: slice, data: bytes, /) -> None: ...


class FileView:
    """Slices of a file through pread and pwrite, for what clients may write; the service maps only what it alone can.

    A file that a client has truncated is a short read, which no CRC passes, and not a SIGBUS that kills the reader.
    """

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def __getitem__(self, where: slice) -> bytes:
        return os.pread(self.fd, where.stop - where.start, where.start)

    def __setitem__(self, where: slice, data: bytes) -> None:
        os.pwrite(self.fd, data, where.start)


class PayloadTooLarge(ValueError):
    """A payload did not fit the capacity its record declares in the layout."""


def seed(record: str, incarnation: int) -> int:
    """The CRC seed of a record (`segment.record`) in the run with this incarnation."""
    return crc32(record.encode(), crc32(incarnation.to_bytes(8, "little")))


def build(seq: int, t_ns: int, payload: bytes, crc_seed: int, capacity: int) -> bytes:
    """Return the cell's bytes, ready for one slice assignment; `seq` starts at 1 (0 means never written)."""
    if len(payload) > capacity:
        raise PayloadTooLarge(f"payload of {len(payload)} bytes, the record holds {capacity}")
    body = _BODY.pack(len(payload), seq, t_ns) + payload
    return _CRC.pack(crc32(body, crc_seed)) + body


def check(raw: bytes, crc_seed: int) -> Entry | None:
    """Return (seq, t_mono_ns, payload) of a cell's private copy, or None when it is not whole."""
    if len(raw) < CELL_HEADER_BYTES:
        return None
    crc, length, seq, t_ns = _HEAD.unpack_from(raw)
    end = CELL_HEADER_BYTES + length
    if seq == 0 or end > len(raw) or crc32(raw[4:end], crc_seed) != crc:
        return None
    return seq, t_ns, raw[CELL_HEADER_BYTES:end]


def cell_bytes(capacity: int) -> int:
    """Bytes that one cell of this capacity takes: whole 64-byte lines, so that no two cells share one."""
    return -(-(CELL_HEADER_BYTES + capacity) // LINE_BYTES) * LINE_BYTES


class _Cells:
    """The cells of one record, one after another."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        self._view = view
        self._at = offset
        self._capacity = capacity
        self._cells = cells
        self._size = cell_bytes(capacity)
        self._seed = crc_seed

    def _slice(self, seq: int) -> slice:
        """Where the entry with this number is stored."""
        at = self._at + seq % self._cells * self._size
        return slice(at, at + self._size)

    def _last(self) -> int:
        """The number of the newest whole entry; 0 if none exists."""
        return max(self._whole(), default=0)

    def _whole(self) -> list[int]:
        """Sequence numbers of all whole entries, read in one copy. Not for a hot path. Most rings are nearly empty."""
        raw, size = self._view[self._at : self._at + self._cells * self._size], self._size
        seqs = enumerate(struct.iter_unpack(f"<8xQ{size - 16}x", raw[: len(raw) // size * size]))
        return [n for i, (n,) in seqs if n % self._cells == i and check(raw[i * size : (i + 1) * size], self._seed)]


class LatestReader(_Cells):
    """Reads the newest whole value of a record. Bytes that have not changed are not checked again: they are copied and
    compared, which is a third of the work. A record that nobody has written is zeros."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._where = slice(offset, offset + cells * self._size)
        self._seen = 0
        self._raw = b""
        """The bytes of the value that was read last; empty if no cell was whole."""
        self._known: Entry | None = None

    def read(self) -> Entry | None:
        """Return (seq, t_mono_ns, payload) of the newest whole value, or None if none exists."""
        raw = self._view[self._where]
        if raw == self._raw:
            return self._known
        entry = self._newest(raw)
        # Two writes that overtake the copy leave it without a whole value, or with one older than a value seen before.
        for _ in range(2):
            if (entry and entry[0] >= self._seen) or not raw.strip(b"\0"):
                break
            Barrier()()  # without this barrier, the loads of this copy may be as old as those of the copy before
            raw = self._view[self._where]
            entry = self._newest(raw)
        self._raw, self._known = raw, entry
        self._seen = entry[0] if entry else self._seen
        return entry

    def _newest(self, raw: bytes) -> Entry | None:
        found = check(raw[: self._size], self._seed), check(raw[self._size :], self._seed)
        return max(filter(None, found), default=None)


class _Writer(_Cells):
    """The only writer of a record. A writer that takes over from a dead one goes on after the newest whole entry. A
    cell that was torn by the death is overwritten, and the entry before it stays readable."""

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._barrier = Barrier()
        self.seq = self._last()
        """The number of the newest entry; 0 if none exists."""

    def put(self, payload: bytes, t_ns: int | None = None) -> int:
        """Publish an entry; returns its sequence number. Raises PayloadTooLarge, and then changes nothing."""
        seq = self.seq + 1
        data = build(seq, monotonic_ns() if t_ns is None else t_ns, payload, self._seed, self._capacity)
        at = self._slice(seq).start
        self._barrier()
        self._view[at : at + len(data)] = data
        self.seq = seq
        return seq


class LatestWriter(_Writer):
    """Publishes values of which only the newest counts."""

    write = _Writer.put


class RingWriter(_Writer):
    """Appends entries in order, for any number of readers. There is no shared head or tail, no reader state in shared
    memory and no lock: entry `n` is in cell `n % cells`. A reader that sees an entry also sees everything that its
    writer stored before it, including earlier entries, because there is a barrier in between."""

    def put_all(self, data: bytes, t_ns: int | None = None) -> None:
        """Publish bytes of any length, split into entries."""
        for at in range(0, len(data), self._capacity):
            self.put(data[at : at + self._capacity], t_ns)


class RingReader(_Cells):
    """One reader's place in a ring. `lost` counts the entries that were overwritten before they were read.

    Reading entry n: (1) one slice copy of cell n % cells, (2) check it:
        its seq is n                       -> the entry
        its seq is below n, or never used  -> not published yet
        its seq is above n                 -> lapped: go on at the oldest entry that can still be whole
        not whole                          -> being written, or damaged: once a later entry is whole, n is gone for
                                              good, so go on at the oldest of those
    """

    def __init__(
        self, view: View, offset: int, capacity: int, cells: int, crc_seed: int, *, from_oldest: bool = False
    ) -> None:
        super().__init__(view, offset, capacity, cells, crc_seed)
        self._blank = bytes(self._size)
        self.lost = 0
        self._old = b""
        """The bytes of this cell that were found to be blank or an older entry. The same bytes need no second check."""
        last = self._last()
        self._await(max(1, last - cells + 1) if from_oldest else last + 1)

    def next(self) -> Entry | None:
        """Return the next entry (seq, t_mono_ns, payload) in order, or None when nothing new is published."""
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
                # Go on at the oldest entry, `cells - 1` before this one. In a ring at rest that takes fewer steps than
                # there are cells; but a writer at full speed overwrites the oldest entry again and again, so each
                # further lap goes back half as far, in the end to this very entry.
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
        """The entry in a copy of the next cell. A whole entry that belongs in another cell counts as damage."""
        entry = check(raw, self._seed)
        if entry and (entry[0] - self._next) % self._cells:
            return None
        return entry

    def _resume(self, seq: int) -> None:
        self.lost += seq - self._next
        self._await(seq)

    def _pass_damage(self) -> bool:
        """False if the cell may still become the next entry; True if it is worth another look, or was passed over.
        Without this, one damaged cell would hold up the reader for a whole lap, and with it the stops that follow in
        the ring.
        """
        later = [seq for seq in self._whole() if seq > self._next]
        if not later:
            return False
        # The entry and later ones may have been published while the ring was searched.
        Barrier()()
        if self._check(self._view[self._where]) is None:
            self._resume(min(later))
        return True
