"""A tap on an open port: what the board sends, decoded, with the time of its reading; and pings."""

from __future__ import annotations

import os
import select
import time

from failstop.board.decoder import Decoder
from failstop.board.interface import BOARD

CHUNK = 4096
Frame = tuple[int, int, bytes]
"""(time of reading, function, data)."""


class Tap:
    """Reads a descriptor that is not blocking; it stays the caller's."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._decoder = Decoder()
        self._pings = 0

    def read(self) -> list[Frame]:
        """The frames that have come. Raises OSError when the device has gone."""
        found: list[Frame] = []
        while True:
            try:
                data = os.read(self.fd, CHUNK)
            except BlockingIOError:
                return found
            if not data:
                raise OSError("the device has gone")
            now_ns = time.monotonic_ns()
            found += [(now_ns, func, body) for func, body in self._decoder.feed(data)]

    def ping(self) -> tuple[int, int]:
        """Ask the board; returns (index of the ping, when it was written). Raises OSError."""
        index = self._pings % len(BOARD.pings)
        self._pings += 1
        now_ns = time.monotonic_ns()
        os.write(self.fd, BOARD.pings[index])
        return index, now_ns

    def answer_ns(self, index: int, timeout_s: float) -> int | None:
        """When the answer to that ping came; None: it did not. Raises OSError."""
        until_s = time.monotonic() + timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            select.select((self.fd,), (), (), left_s)
            for now_ns, func, data in self.read():
                if BOARD.pong(func, data) == index:
                    return now_ns
        return None
