"""Repeats: what is written again after a stop, and when. Pure.

After a cause the burst is repeated after 20 and 100 ms, in case the board lost the first. While stopped a zero frame
goes out at 5 Hz, so that a board that restarts or wakes hears a stop soon.
"""

from __future__ import annotations

from failstop.procs.loop import NEVER, Timer

BURST = 1
ZERO = 2
BURST_AFTER_NS = (20_000_000, 100_000_000)
LEAVE_AFTER_NS = 150_000_000
"""How long the stop's writers outlive the supervisor: the burst and its two repeats."""
ZERO_EVERY_NS = 200_000_000


class Repeats:
    """The schedule since the last stop; `due`: of what is next."""

    __slots__ = ("_bursts", "_due")

    def __init__(self, due: Timer, now_ns: int) -> None:
        self._bursts = 0
        self._due = due
        due.set(now_ns)

    def restart(self, now_ns: int) -> None:
        """A stop was just written."""
        self._bursts = len(BURST_AFTER_NS)
        self._due.set(*(now_ns + after for after in (*BURST_AFTER_NS, ZERO_EVERY_NS)))

    def motion(self) -> None:
        """Motion was written: an earlier stop is over and must not cut into it. No zeros before the next."""
        self._due.set(NEVER)

    def take(self, now_ns: int) -> int:
        """BURST, ZERO or 0: what is to be written now. Asking takes it off the schedule."""
        if not self._due.take(now_ns):
            return 0
        if self._bursts:
            self._bursts -= 1
            return BURST
        self._due.set(now_ns + ZERO_EVERY_NS)
        return ZERO
