"""Ring: a stream of entries from one writer to any number of readers, in order.

There is no shared head or tail, no reader state in shared memory and no lock: entry `n` lives in cell `n % cells`.

Writing entry n: (1) build the cell with seq n privately, (2) a barrier, (3) one slice assignment: whoever sees an entry
                 sees what its writer stored before it, and the entries before it among that.
Reading entry n: (1) one slice copy of cell n % cells, (2) check it:
    its seq is n                       -> the entry
    its seq is below n, or never used  -> not published yet
    its seq is above n                 -> lapped: go on at the oldest entry that can still be whole, count what was lost
    not whole                          -> being written, or damaged: once a later entry is whole, n is gone for good, so
                                          go on at the oldest of those and count what was lost
A writer that takes over from a dead one goes on after the newest whole entry; a cell torn by the death is overwritten.
"""

from __future__ import annotations

from time import monotonic_ns

from failstop.shm import cell
from failstop.shm.barrier import Barrier
from failstop.shm.latest import cell_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.cell import Entry
    from failstop.shm.views import View


def _whole(view: View, offset: int, size: int, cells: int, crc_seed: int) -> list[int]:
    """Sequence numbers of all whole entries. Looks at every cell: not for a hot path."""
    found = []
    for i in range(cells):
        entry = cell.check(view[offset + i * size : offset + (i + 1) * size], crc_seed)
        if entry and entry[0] % cells == i:
            found.append(entry[0])
    return found


def newest(view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> int:
    """Sequence number of the newest whole entry, 0 when there is none. Looks at every cell: not for a hot path."""
    return max(_whole(view, offset, cell_bytes(capacity), cells, crc_seed), default=0)


class RingWriter:
    """The ring's one writer."""

    __slots__ = ("_at", "_barrier", "_capacity", "_cells", "_seed", "_size", "_view", "seq")

    def __init__(self, view: View, offset: int, capacity: int, cells: int, crc_seed: int) -> None:
        self._view = view
        self._at = offset
        self._capacity = capacity
        self._cells = cells
        self._size = cell_bytes(capacity)
        self._seed = crc_seed
        self._barrier = Barrier()
        self.seq = newest(view, offset, capacity, cells, crc_seed)

    def put(self, payload: bytes, t_ns: int | None = None) -> int:
        """Append an entry; returns its sequence number. Raises PayloadTooLarge, and then nothing is changed."""
        seq = self.seq + 1
        data = cell.build(seq, monotonic_ns() if t_ns is None else t_ns, payload, self._seed, self._capacity)
        at = self._at + (seq % self._cells) * self._size
        self._barrier()
        self._view[at : at + len(data)] = data
        self.seq = seq
        return seq


class RingReader:
    """One reader's place in the ring. `lost` counts the entries that were overwritten before it came to them."""

    __slots__ = ("_at", "_blank", "_cells", "_next", "_old", "_seed", "_size", "_view", "_where", "lost")

    def __init__(
        self, view: View, offset: int, capacity: int, cells: int, crc_seed: int, *, from_oldest: bool = False
    ) -> None:
        self._view = view
        self._at = offset
        self._cells = cells
        self._size = cell_bytes(capacity)
        self._seed = crc_seed
        self._blank = bytes(self._size)
        self.lost = 0
        self._old = b""
        """The bytes of its cell that were found to be an older entry, or blank: the same again need no other look."""
        last = newest(view, offset, capacity, cells, crc_seed)
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
                # In a ring at rest this takes fewer steps than there are cells. A writer at full speed overwrites the
                # oldest entry again and again (400 steps for one entry, measured): then go on closer to the newest.
                self._resume(entry[0] - (self._cells - 1 >> max(0, laps - self._cells)))
                laps += 1
            if entry[0] == self._next:
                self._await(entry[0] + 1)
                return entry

    def _await(self, seq: int) -> None:
        self._next = seq
        at = self._at + seq % self._cells * self._size
        self._where = slice(at, at + self._size)
        self._old = b""

    def _check(self, raw: bytes) -> Entry | None:
        """What a copy of the next entry's cell holds; what is whole but belongs in another cell is damage too."""
        entry = cell.check(raw, self._seed)
        if entry and (entry[0] - self._next) % self._cells:
            return None
        return entry

    def _resume(self, seq: int) -> None:
        self.lost += seq - self._next
        self._await(seq)

    def _pass_damage(self) -> bool:
        """False when the cell may yet become the next entry; True when it is worth another look, or was passed.

        A damaged cell would hold a reader up for a whole lap, and with it the stops that follow in the ring.
        """
        later = [seq for seq in _whole(self._view, self._at, self._size, self._cells, self._seed) if seq > self._next]
        if not later:
            return False
        # It may have been published, and others after it, while the ring was looked through.
        Barrier()()
        if self._check(self._view[self._where]) is None:
            self._resume(min(later))
        return True
