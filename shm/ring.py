"""Ring: a stream of entries from one writer to any number of readers, in order.

There is no shared head or tail, no reader state in shared memory and no lock: entry `n` lives in slot `n % slots`.

Writing entry n: (1) build the slot with seq n privately, (2) a barrier, (3) one slice assignment: whoever sees an entry
                 sees what its writer stored before it, and the entries before it among that.
Reading entry n: (1) one slice copy of slot n % slots, (2) check it:
    its seq is n                       -> the entry
    its seq is below n, or never used  -> not published yet
    its seq is above n                 -> lapped: go on at the oldest entry that can still be whole, count what was lost
    not whole                          -> being written, or damaged: once a later entry is whole, n is gone for good, so
                                          go on at the oldest of those and count what was lost
A writer that takes over from a dead one goes on after the newest whole entry; a slot torn by the death is overwritten.
"""

from __future__ import annotations

from time import monotonic_ns

from failstop.shm import slot
from failstop.shm.barrier import Barrier
from failstop.shm.latest import slot_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.slot import Entry
    from failstop.shm.views import View


def _whole(view: View, offset: int, size: int, slots: int, crc_seed: int) -> list[int]:
    """Sequence numbers of all whole entries. Looks at every slot: not for a hot path."""
    found = []
    for i in range(slots):
        entry = slot.check(view[offset + i * size : offset + (i + 1) * size], crc_seed)
        if entry and entry[0] % slots == i:
            found.append(entry[0])
    return found


def newest(view: View, offset: int, capacity: int, slots: int, crc_seed: int) -> int:
    """Sequence number of the newest whole entry, 0 when there is none. Looks at every slot: not for a hot path."""
    return max(_whole(view, offset, slot_bytes(capacity), slots, crc_seed), default=0)


class RingWriter:
    """The ring's one writer."""

    __slots__ = ("_at", "_barrier", "_capacity", "_seed", "_size", "_slots", "_view", "seq")

    def __init__(self, view: View, offset: int, capacity: int, slots: int, crc_seed: int) -> None:
        self._view = view
        self._at = offset
        self._capacity = capacity
        self._slots = slots
        self._size = slot_bytes(capacity)
        self._seed = crc_seed
        self._barrier = Barrier()
        self.seq = newest(view, offset, capacity, slots, crc_seed)

    def put(self, payload: bytes, t_ns: int | None = None) -> int:
        """Append an entry; returns its sequence number. Raises PayloadTooLarge, and then nothing is changed."""
        seq = self.seq + 1
        data = slot.build(seq, monotonic_ns() if t_ns is None else t_ns, payload, self._seed, self._capacity)
        at = self._at + (seq % self._slots) * self._size
        self._barrier()
        self._view[at : at + len(data)] = data
        self.seq = seq
        return seq


class RingReader:
    """One reader's place in the ring. `lost` counts the entries that were overwritten before it came to them."""

    __slots__ = ("_at", "_blank", "_next", "_old", "_seed", "_size", "_slots", "_view", "_where", "lost")

    def __init__(
        self, view: View, offset: int, capacity: int, slots: int, crc_seed: int, *, from_oldest: bool = False
    ) -> None:
        self._view = view
        self._at = offset
        self._slots = slots
        self._size = slot_bytes(capacity)
        self._seed = crc_seed
        self._blank = bytes(self._size)
        self.lost = 0
        self._old = b""
        """The bytes of its slot that were found to be an older entry, or blank: the same again need no other look."""
        last = newest(view, offset, capacity, slots, crc_seed)
        self._await(max(1, last - slots + 1) if from_oldest else last + 1)

    def next(self) -> Entry | None:
        """Return the next entry (seq, t_mono_ns, payload) in order, or None when nothing new is published."""
        laps = 0
        while True:
            raw = self._view[self._where]
            if raw == self._old:
                return None
            entry = self._check(raw)
            if entry is None:
                if raw == self._blank and self._next <= self._slots:
                    self._old = raw
                    return None
                if not self._pass_damage():
                    return None
                continue
            if entry[0] < self._next:
                self._old = raw
                return None
            if entry[0] > self._next:
                # In a ring at rest this takes fewer steps than there are slots. A writer at full speed overwrites the
                # oldest entry again and again (400 steps for one entry, measured): then go on closer to the newest.
                self._resume(entry[0] - (self._slots - 1 >> max(0, laps - self._slots)))
                laps += 1
            if entry[0] == self._next:
                self._await(entry[0] + 1)
                return entry

    def _await(self, seq: int) -> None:
        self._next = seq
        at = self._at + seq % self._slots * self._size
        self._where = slice(at, at + self._size)
        self._old = b""

    def _check(self, raw: bytes) -> Entry | None:
        """What a copy of the next entry's slot holds; what is whole but belongs in another slot is damage too."""
        entry = slot.check(raw, self._seed)
        if entry and (entry[0] - self._next) % self._slots:
            return None
        return entry

    def _resume(self, seq: int) -> None:
        self.lost += seq - self._next
        self._await(seq)

    def _pass_damage(self) -> bool:
        """False when the slot may yet become the next entry; True when it is worth another look, or was passed.

        A damaged slot would hold a reader up for a whole lap, and with it the stops that follow in the ring.
        """
        later = [seq for seq in _whole(self._view, self._at, self._size, self._slots, self._seed) if seq > self._next]
        if not later:
            return False
        # It may have been published, and others after it, while the ring was looked through.
        Barrier()()
        if self._check(self._view[self._where]) is None:
            self._resume(min(later))
        return True
