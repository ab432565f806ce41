"""Restart policy. Pure: deaths and times in, delays out."""

from __future__ import annotations


class Restarts:
    """Counts one process's deaths: the first in the window is restarted at once, the next after a doubling wait, and
    after the limit it is down (and the service stopped) until people reset, rather than loop."""

    def __init__(self, limit: int, window_ns: int, backoff_ns: int) -> None:
        self._limit = limit
        self._window_ns = window_ns
        self._backoff_ns = backoff_ns
        self._deaths: list[int] = []

    def died(self, now_ns: int) -> int | None:
        """Return the wait before the restart in ns, or None: leave it down."""
        self._deaths = [t for t in self._deaths if now_ns - t < self._window_ns]
        self._deaths.append(now_ns)
        count = len(self._deaths)
        if count >= self._limit:
            return None
        return 0 if count == 1 else min(self._backoff_ns << min(count - 2, 16), LONGEST_WAIT_NS)

    def forget(self) -> None:
        """People have seen to it."""
        self._deaths.clear()


LONGEST_WAIT_NS = 2_000_000_000
