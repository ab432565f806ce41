"""Questions: the proof that a terminal is still at the other end of a line, such as ssh. Pure: times are arguments.

The cursor is put at a column that changes each time, and the terminal is asked where it is. A terminal answers by
itself and in order, so that an answer belongs to the oldest question of that column, however late it comes: what a
network held back proves the past alone.
"""

from __future__ import annotations

import re
from collections import deque

PLACES = 60
"""Different columns in turn: with a question every 0.1 s they repeat after 6 s."""
ANSWER = re.compile(rb"\x1b\[(\d{1,4});(\d{1,4})R")
MOST_KEPT = 32
"""Bytes of an answer that is not whole yet."""


class Questions:
    """What was asked, and what was answered."""

    def __init__(self) -> None:
        self._open: deque[tuple[int, int]] = deque()
        self._number = 0
        self._rest = b""
        self.proven_ns = 0
        """When the newest question that has an answer was put; 0: none has."""

    def ask(self, now_ns: int, row: int) -> str:
        """The next question, to be written."""
        column = 2 + self._number % PLACES
        self._number += 1
        self._open.append((column, now_ns))
        return f"\x1b[{row};{column}H\x1b[6n"

    def typed(self, data: bytes) -> bytes:
        """What came from the terminal: answers are taken, and the rest, which a person typed, comes back."""
        data = self._rest + data
        for found in ANSWER.finditer(data):
            self._take(int(found[2]))
        rest = ANSWER.sub(b"", data)
        # An answer may come in two pieces.
        at = rest.rfind(b"\x1b")
        whole = at < 0 or len(rest) - at > MOST_KEPT or not re.fullmatch(rb"\x1b(\[[\d;]*)?", rest[at:])
        self._rest = b"" if whole else rest[at:]
        return rest if whole else rest[:at]

    def _take(self, column: int) -> None:
        if not any(asked == column for asked, _ in self._open):
            return
        while self._open:
            asked, put_ns = self._open.popleft()  # those before it were lost: answers come in order
            if asked == column:
                self.proven_ns = put_ns
                return
