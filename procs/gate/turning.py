"""Turning: notices from the board's reports that the wheels turn while motion is enabled but zero is commanded."""

from __future__ import annotations

from failstop.messages import records
from failstop.shm.cell import LatestReader

_BY_REPORTS = records.WHEELS_BY.index("wheels")


class TurningWatch:
    """Notices wheels that turn although zero is commanded. Call check() once per tick."""

    def __init__(self, seen: LatestReader, after_ns: int) -> None:
        """`seen`: reads telemetry's record of the wheels. `after_ns`: how long the wheels may turn after zero was
        commanded."""
        self._seen, self._after_ns = seen, after_ns
        self._idle_ns = 0
        """The time since which motion is enabled and zero is commanded. 0 while this is not so."""

    def check(self, now_ns: int, *, idle: bool) -> str:
        """Return the reason why motion must be disabled, or an empty text if there is none. `idle`: True if motion is
        enabled and zero is commanded."""
        self._idle_ns = (self._idle_ns or now_ns) if idle else 0
        if not idle or now_ns - self._idle_ns < self._after_ns:
            return ""
        entry = self._seen.read()
        # An older report is about earlier commands, from before zero had been commanded for long enough.
        if entry is None or entry[1] - self._idle_ns < self._after_ns:
            return ""
        _, by, unexpected, *_ = records.WHEELS_SEEN.unpack(entry[2])
        if not unexpected or by != _BY_REPORTS:
            return ""
        return f"the wheels turn although they were told zero for {self._after_ns / 1e9:g} s"
