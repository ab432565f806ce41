"""Pace: how fast the wheels turn, compared with how fast they are commanded to turn, by the board's reports. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from failstop.board.interface import WheelReports
from failstop.policy import scale
from failstop.procs.telemetry.scale import LEAST_RPS, Ratio
from failstop.procs.telemetry.wheels import Measured


class Pace:
    """Compares the wheels of one drive with their command. All wheels that are driven must get the same speed.

    A single report says little. A UGV, for example, reports the speed of its last loop, and at a steady speed it jumps
    by half. So positions are used if the board counts turns, and otherwise the mean of all speeds.
    """

    def __init__(self, reports: WheelReports) -> None:
        self._measured = Measured(reports, summed=True)
        self._fits = scale.WHEELS_FIT[reports.holds_speed]
        self._ratios: list[Ratio] = []
        self._last_ns = 0
        self._most_rps = 0.0
        """The highest commanded speed so far, in turns per second."""

    def add(self, speeds: Sequence[float], positions: tuple[float, ...], told_rps: float, t_ns: int) -> None:
        """Add a report that was read at `t_ns`. `told_rps`: the speed that was commanded then, in turns per second; 0
        if it is not known."""
        measured, self._most_rps = self._measured, max(self._most_rps, told_rps)
        is_new = measured.add(() if measured.counts else speeds, positions, t_ns)
        elapsed_s = (t_ns - self._last_ns) * 1e-9 if self._last_ns else 0.0
        if is_new or not self._last_ns:
            self._last_ns = t_ns
        if not is_new:
            return
        self._ratios += [Ratio(LEAST_RPS) for _ in measured.speeds_rps[len(self._ratios) :]]
        for ratio, rps in zip(self._ratios, measured.speeds_rps, strict=False):
            ratio.add(told_rps, rps, elapsed_s)

    @property
    def ratio(self) -> float:
        """The speed of the fastest wheel divided by the commanded speed. 0.0 if nothing was compared. 1.0 if the wheel
        may be as fast as commanded, because a short drive measures only roughly, and a wheel lags while it speeds
        up. Positions may leave out one count of a slow wheel. It is added, because a scale that is too small makes the
        robot slow, and one that is too large makes it fast."""
        compared = [each for each in self._ratios if each.known.seconds]
        if not compared:
            return 0.0
        fastest = max(compared, key=lambda each: abs(each.known.ratio))
        if not fastest.differs(1 / self._fits, self._fits):
            return 1.0
        ratio = abs(fastest.known.ratio)
        return ratio if ratio > 1 else ratio + self._measured.step / (self._most_rps * fastest.known.seconds)
