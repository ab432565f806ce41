"""Repeats: what is written again after a stop, and when. Pure.

After a cause the burst is repeated after 20 and 100 ms, in case the board lost the first. While stopped a zero frame
goes out at 5 Hz, so that a board that restarts or wakes hears a stop soon.
"""

from __future__ import annotations

BURST = 1
ZERO = 2
BURST_AFTER_NS = (20_000_000, 100_000_000)
LEAVE_AFTER_NS = 150_000_000
"""How long the stop's writers outlive the supervisor: the burst and its two repeats."""
ZERO_EVERY_NS = 200_000_000


class Repeats:
    """The schedule since the last stop."""

    __slots__ = ("_bursts", "_zero_ns")

    def __init__(self, now_ns: int) -> None:
        self._bursts: tuple[int, ...] = ()
        self._zero_ns = now_ns

    def restart(self, now_ns: int) -> None:
        """A stop was just written."""
        self._bursts = tuple(now_ns + after for after in BURST_AFTER_NS)
        self._zero_ns = now_ns + ZERO_EVERY_NS

    def motion(self) -> None:
        """Motion was written: an earlier stop is over and must not cut into it."""
        self._bursts = ()

    def due(self, now_ns: int, *, moving: bool) -> int:
        """BURST, ZERO or 0: what is to be written now. Asking takes it off the schedule."""
        if self._bursts and now_ns >= self._bursts[0]:
            self._bursts = self._bursts[1:]
            return BURST
        if not moving and now_ns >= self._zero_ns:
            self._zero_ns = now_ns + ZERO_EVERY_NS
            return ZERO
        return 0

    def next_ns(self, *, moving: bool) -> int | None:
        """When to ask again; None: not before the next stop."""
        if self._bursts:
            return self._bursts[0]  # the next zero frame comes after both
        return None if moving else self._zero_ns
