"""Allowance: how many bytes of one sort of event people are told in a minute, whoever brings them about. Pure.

A bucket that fills up within a minute. Once it is empty nothing more is told until a part of it is there again, and
then first how much was left out: a flood is a few lines and a number, not every other line of it.
"""

from __future__ import annotations

MINUTE_NS = 60_000_000_000
OWN_BYTES = 65536
"""Of each kind and level: a dozen stops a second for half a minute, and then one every three seconds."""
ASKED_BYTES = 8192
"""Of requests that repeat what is latched: everybody may make them, without end, and they change nothing."""
REOPENS_AT = 4
"""Once this part of the bucket is there."""


class Allowance:
    """One sort's bucket."""

    __slots__ = ("_left", "_most", "_ns", "_shut", "left_out")

    def __init__(self, most: int, now_ns: int) -> None:
        self._most = most
        self._left: float = most
        self._ns = now_ns
        self._shut = False
        self.left_out = 0
        """Events that were not told since the last that was."""

    def _fill(self, now_ns: int) -> None:
        earned = max(0, now_ns - self._ns) * self._most / MINUTE_NS
        self._left = min(self._most, self._left + earned)
        self._ns = max(self._ns, now_ns)

    def spend(self, size: int, now_ns: int) -> bool:
        """True when an event of `size` bytes may be told now."""
        self._fill(now_ns)
        if self._shut or size > self._left:
            self._shut = True
            self.left_out += 1
            return False
        self._left -= size
        return True

    def reopens(self, now_ns: int) -> bool:
        """True when there is room for more again."""
        self._fill(now_ns)
        return self._left * REOPENS_AT >= self._most

    def reopen(self) -> int:
        """Go on telling; returns how many were left out."""
        count, self.left_out, self._shut = self.left_out, 0, False
        return count
