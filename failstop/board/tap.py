"""Tap: an open port, from outside of the service: what the board says there, and its answer to a question."""

from __future__ import annotations

import os
import select
import time

from failstop.board.interface import HEARD_PONG, Board
from failstop.board.port import waiting_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.interface import Value


class Tap:
    """A tap on an open port: what the board sends, decoded, with the time of its reading; and pings. It reads a
    descriptor that is not blocking, which stays the caller's."""

    def __init__(self, fd: int, board: Board) -> None:
        self.fd = fd
        self._board = board
        self._hearing = board.hearing()
        self._pings = 0

    def read(self) -> list[tuple[int, int, Value]]:
        """(time of reading, kind, value) of what has been said. Raises OSError when the device has gone."""
        found: list[tuple[int, int, Value]] = []
        while data := waiting_bytes(self.fd):
            now_ns = time.monotonic_ns()
            found += [(now_ns, *said) for said in self._hearing.feed(data)]
        if data is None:
            raise OSError("the device has gone")
        return found

    def ping(self) -> tuple[int, int]:
        """Ask the board; returns (index of the ping, when it was written). Raises OSError."""
        index = self._pings % len(self._board.pings)
        self._pings += 1
        now_ns = time.monotonic_ns()
        os.write(self.fd, self._board.pings[index])
        return index, now_ns

    def answered_ms(self, timeout_s: float) -> float | None:
        """Ask the board; after how long it answered, which is behind all that was written before; None: it did not, or
        has no ping. Raises OSError."""
        if not self._board.pings:
            return None
        index, asked_ns = self.ping()
        until_s = time.monotonic() + timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            select.select((self.fd,), (), (), left_s)
            for now_ns, kind, said in self.read():
                if kind == HEARD_PONG and said == (index,):
                    return (now_ns - asked_ns) / 1e6
        return None
