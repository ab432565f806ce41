"""Turning: notices wheels that turn although motion is enabled and zero is commanded, by the board's reports."""

from __future__ import annotations

from failstop.messages import records
from failstop.shm.cell import LatestReader

_BY_REPORTS = records.WHEELS_BY.index("wheels")


class TurningWatch:
    """Watches for such wheels. Call check() once per tick."""

    def __init__(self, seen: LatestReader, after_ns: int) -> None:
        """`seen`: telemetry's record of the wheels; `after_ns`: how long they may turn after zero was commanded."""
        self._seen, self._after_ns = seen, after_ns
        self._idle_ns = 0
        """Since when motion is enabled and zero is commanded; 0 if it is not."""

    def check(self, now_ns: int, *, idle: bool) -> str:
        """Why motion must be disabled; empty if there is no reason. `idle`: motion is enabled and zero is commanded."""
        self._idle_ns = (self._idle_ns or now_ns) if idle else 0
        if not idle or now_ns - self._idle_ns < self._after_ns:
            return ""
        entry = self._seen.read()
        # A report from before the wheels were told zero for this long is about other commands.
        if entry is None or entry[1] - self._idle_ns < self._after_ns:
            return ""
        _, by, unexpected, *_ = records.WHEELS_SEEN.unpack(entry[2])
        if not unexpected or by != _BY_REPORTS:
            return ""
        return f"the wheels turn although they were told zero for {self._after_ns / 1e9:g} s"
