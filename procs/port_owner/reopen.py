"""Reopening a lost port: by its path, until the device is back."""

from __future__ import annotations

from failstop.board import port


class Reopener:
    """Tries the path at most every EVERY_NS; `opened` counts the ports of this process."""

    EVERY_NS = 5_000_000

    __slots__ = ("_next_ns", "opened", "path")

    def __init__(self, path: str) -> None:
        self.path = path
        self.opened = 1
        self._next_ns = 0

    def try_open(self, now_ns: int) -> int:
        """Return a newly opened port, or -1 when it is not there yet."""
        if now_ns < self._next_ns:
            return -1
        self._next_ns = now_ns + self.EVERY_NS
        fd = port.open_if_there(self.path)
        self.opened += fd >= 0
        return fd
