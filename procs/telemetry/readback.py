"""Read-back: judges from the board's own reports whether the wheels are still. Pure.

If the board reports only speeds, the wheels are still when all speeds are zero. If it reports positions, the wheels are
still when two reports that are far enough apart have the same positions and the newer report shows no speed. This needs
no IMU, and is more reliable than an IMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

AT_REST = 1e-6
"""A speed below this counts as zero, in any unit."""
READS_APART_NS = 40_000_000
"""Two reports of positions that are closer together than this, in ns, are never compared, because a slow wheel may have
the same position in both. If a wheel goes far in one count, the time is longer (WheelReports.apart_ns)."""


class ReadBack:
    """Judges from the board's reports whether the wheels are still. `still_ns`: since when the wheels have been still,
    or 0 if they turn. `judged_ns`: the time of the last judged report, or 0 if there is none."""

    def __init__(self, apart_ns: int = 0) -> None:
        """`apart_ns`: WheelReports.apart_ns of the board."""
        self._apart_ns = max(READS_APART_NS, apart_ns)
        self.still_ns = self.judged_ns = 0
        self._before: tuple[int, tuple[float, ...]] | None = None

    def add(self, speeds: Sequence[float], positions: tuple[float, ...], t_ns: int) -> bool:
        """Add a report. Returns True if the report gives a verdict or withdraws one. A NaN or infinite value withdraws
        the verdict."""
        if not all(map(isfinite, (*speeds, *positions))):
            known, self._before = self.judged_ns > 0, None
            self.still_ns = self.judged_ns = 0
            return known
        rests = self._rests(speeds, positions, t_ns)
        if rests is None:
            return False
        self.judged_ns = t_ns
        self.still_ns = (self.still_ns or t_ns) if rests else 0
        return True

    def _rests(self, speeds: Sequence[float], positions: tuple[float, ...], t_ns: int) -> bool | None:
        """Return True if the report says that the wheels are still, False if they turn, and None if that is not known
        yet."""
        if any(abs(speed) > AT_REST for speed in speeds):
            self._before = (t_ns, positions)
            return False
        if not positions:
            return True if speeds else None
        before = self._before
        if before is None or t_ns - before[0] < self._apart_ns:
            self._before = before or (t_ns, positions)
            return None
        self._before = (t_ns, positions)
        return before[1] == positions
