"""Memory under a reader or writer that a test can see into, and tear."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from failstop.shm import cell


class Memory:
    """A View over private bytes; `before_copy` runs ahead of each copy. The next store stops after `left` bytes, as if
    the writer had been killed there."""

    def __init__(self, size: int) -> None:
        self.data = bytearray(size)
        self.copies: list[slice] = []
        self.stores: list[tuple[int, bytes]] = []
        self.before_copy: Callable[[], object] = lambda: None
        self.left: int | None = None

    def __getitem__(self, where: slice) -> bytes:
        self.before_copy()
        self.copies.append(where)
        return bytes(self.data[where])

    def __setitem__(self, where: slice, data: bytes) -> None:
        assert where.stop - where.start == len(data), "a slice assignment that would move what follows"
        assert type(data) is bytes, "not built privately"
        if self.left is None:
            self.stores.append((where.start, data))
            self.data[where] = data
            return
        done, self.left = data[: self.left], None
        self.data[where.start : where.start + len(done)] = done
        raise Death


class Death(Exception):
    """Thrown by a store that is cut off."""


def payload_of(seq: int, size: int) -> bytes:
    """The only right payload of entry `seq`: its number over and over, and 8 bytes of a hash that is no CRC."""
    number = seq.to_bytes(8, "little")
    body = number * (size // 8 + 1)
    mixed = (seq * 0x9E3779B97F4A7C15 ^ seq >> 7) & (2**64 - 1)
    return (body[: max(0, size - 8)] + mixed.to_bytes(8, "big"))[:size]


def time_of(seq: int) -> int:
    """The only right time stamp of entry `seq`."""
    return seq * 1009 + 3


def genuine(entry: tuple[int, int, bytes], size: int | None = None) -> bool:
    seq, t_ns, payload = entry
    if size is not None and len(payload) != size:
        return False
    return t_ns == time_of(seq) and payload == payload_of(seq, len(payload))


def exit_after(limit_s: float) -> Callable[[], None]:
    """A check for the loop of a forked child: ends it when it was forgotten."""
    parent, end = os.getppid(), time.monotonic() + limit_s

    def check() -> None:
        if os.getppid() != parent or time.monotonic() > end:
            os._exit(97)

    return check


assert cell.CELL_HEADER_BYTES == 24
