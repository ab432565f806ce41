"""The cell: the unit of everything in shared memory that is wider than one word.

    crc32 u32 | length u32 | seq u64 | t_mono_ns u64 | payload[length]

The CRC covers all that follows it and is seeded with the record's name and the run's incarnation, so bytes of another
record, or of a dead run, never pass as this one's.

Writing: (1) build the whole cell privately, (2) store it with ONE slice assignment.
Reading: (1) take ONE slice copy, (2) check the private copy, (3) use nothing but that copy.

Integrity then needs no memory ordering: whatever mixture of old and new bytes a reader or a death in mid-write leaves,
the CRC of the private copy decides, and a record that is not whole is not read. `struct.pack_into` on shared memory is
never used: it zero-fills first, and a reader would see the zeros.
"""

from __future__ import annotations

import struct
from zlib import crc32

HEADER_BYTES = 24
_HEAD = struct.Struct("<IIQQ")
_BODY = struct.Struct("<IQQ")
_CRC = struct.Struct("<I")

TYPE_CHECKING = False
if TYPE_CHECKING:
    Entry = tuple[int, int, bytes]


class PayloadTooLarge(ValueError):
    """A payload did not fit the capacity its record declares in the layout."""


def seed(record: str, incarnation: int) -> int:
    """CRC seed of a record (`segment.record`) in the run with this incarnation."""
    return crc32(record.encode(), crc32(incarnation.to_bytes(8, "little")))


def build(seq: int, t_ns: int, payload: bytes, crc_seed: int, capacity: int) -> bytes:
    """Return the cell's bytes, ready for one slice assignment; `seq` starts at 1 (0 means never written)."""
    if len(payload) > capacity:
        raise PayloadTooLarge(f"payload of {len(payload)} bytes, the record holds {capacity}")
    body = _BODY.pack(len(payload), seq, t_ns) + payload
    return _CRC.pack(crc32(body, crc_seed)) + body


def sequence(raw: bytes, at: int = 0) -> int:
    """The sequence number a cell claims, unchecked: good only for choosing which cell to check first."""
    if len(raw) < at + HEADER_BYTES:
        return 0
    seq: int = _HEAD.unpack_from(raw, at)[2]
    return seq


def check(raw: bytes, crc_seed: int, at: int = 0, size: int | None = None) -> Entry | None:
    """Return (seq, t_mono_ns, payload) of the private copy `raw[at:at+size]`, or None when it is not whole."""
    end = len(raw) if size is None else min(len(raw), at + size)
    if end - at < HEADER_BYTES:
        return None
    crc, length, seq, t_ns = _HEAD.unpack_from(raw, at)
    stop = at + HEADER_BYTES + length
    if seq == 0 or stop > end:
        return None
    if crc32(raw[at + 4 : stop], crc_seed) != crc:
        return None
    return seq, t_ns, raw[at + HEADER_BYTES : stop]
