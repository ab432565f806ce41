"""Latest: one value, the newest whole one wins.

Two slots, written in turn. A writer that dies in mid-write leaves the value before it readable in the other slot.
"""

from __future__ import annotations

from time import monotonic_ns

from failstop.shm import slot

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.slot import Entry
    from failstop.shm.views import View


class LatestReader:
    """Reads the newest whole value of a record. Bytes that have not changed are not checked again: they are copied and
    compared, which is a third of the work. A record that nobody has written is zeros."""

    __slots__ = ("_known", "_raw", "_seed", "_seen", "_slot_bytes", "_view", "_where")

    def __init__(self, view: View, offset: int, capacity: int, crc_seed: int) -> None:
        self._view = view
        self._slot_bytes = slot_bytes(capacity)
        self._where = slice(offset, offset + 2 * self._slot_bytes)
        self._seed = crc_seed
        self._seen = 0
        self._raw = b""
        """The bytes of the value that was read last; empty: none was whole."""
        self._known: Entry | None = None

    def read(self) -> Entry | None:
        """Return (seq, t_mono_ns, payload) of the newest whole value, or None when there is none."""
        raw = self._view[self._where]
        if raw == self._raw:
            return self._known
        entry = self._whole(raw)
        for _ in range(2):  # two writes that overtake a copy leave it without a value, or with one older than seen
            if (entry and entry[0] >= self._seen) or not raw.strip(b"\0"):
                break
            raw = self._view[self._where]
            entry = self._whole(raw)
        self._raw, self._known = raw, entry
        self._seen = entry[0] if entry else self._seen
        return entry

    def _whole(self, raw: bytes) -> Entry | None:
        size = self._slot_bytes
        first = size if slot.sequence(raw, size) > slot.sequence(raw, 0) else 0
        return slot.check(raw, self._seed, first, size) or slot.check(raw, self._seed, size - first, size)


class LatestWriter:
    """The record's one writer; continues the sequence that a writer before it left."""

    __slots__ = ("_at", "_capacity", "_seed", "_seq", "_slot_bytes", "_view")

    def __init__(self, view: View, offset: int, capacity: int, crc_seed: int) -> None:
        self._view = view
        self._at = offset
        self._capacity = capacity
        self._slot_bytes = slot_bytes(capacity)
        self._seed = crc_seed
        found = LatestReader(view, offset, capacity, crc_seed).read()
        self._seq = found[0] if found else 0

    def write(self, payload: bytes, t_ns: int | None = None) -> int:
        """Publish a value; returns its sequence number. Raises PayloadTooLarge, and then nothing is changed."""
        seq = self._seq + 1
        data = slot.build(seq, monotonic_ns() if t_ns is None else t_ns, payload, self._seed, self._capacity)
        at = self._at + (seq & 1) * self._slot_bytes
        self._view[at : at + len(data)] = data
        self._seq = seq
        return seq


def slot_bytes(capacity: int) -> int:
    """Bytes one slot of this capacity takes: whole 64-byte lines, so that no two slots share one."""
    return (slot.HEADER_BYTES + capacity + 63) // 64 * 64


def record_bytes(capacity: int) -> int:
    """Bytes a Latest record takes."""
    return 2 * slot_bytes(capacity)
