"""Wheels: whether the wheels turn, are still, or nobody knows. Pure.

The board's reports decide. The IMU decides only if there are no reports, because it can't distinguish turning wheels
from a robot that is moved by hand. All screens show this one fact.
"""

from __future__ import annotations

from math import isfinite, nan

from failstop.messages.records import MOST_WHEELS, WHEELS_BY, WHEELS_DO
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import WheelReports

UNKNOWN_WHEELS, ARE_STILL, THEY_TURN = range(len(WHEELS_DO))
SEEN_BY_NOTHING, SEEN_BY_IMU, SEEN_BY_REPORTS = range(len(WHEELS_BY))
_NOT_REPORTED = (nan,) * MOST_WHEELS

LEAST_COUNTS = 2.5
"""The smallest change of a position that counts as movement, in counts. A smaller change is the jitter of an encoder at
rest."""
FASTEST_RPS = 50.0
"""The highest speed that is believed, in turns per second (12 m/s for a wheel of 8 cm). It is higher if the settings
allow high speeds."""
LEAST_TURN = 0.02
"""If a counter changes by fewer turns than this, it has not jumped (5 mm for a wheel of 8 cm)."""
LONGEST_SILENCE_NS = 500_000_000
"""If a board that does not count turns was silent for longer than this, in ns, nobody knows how its wheels turned
meanwhile."""
SAME_READ_NS = 5_000_000
"""Reports that are closer together than this came in one read, so the time between them says nothing about speed. If
a wheel goes far in one count, the time is longer (WheelReports.apart_ns)."""
_AT_ONCE_NS = 250_000_000
"""If a counter has started again at zero, its first report may come up to this much later, in ns."""


def of_every_wheel(values: Sequence[float]) -> tuple[float, ...]:
    """Return these values, filled up with NaN to the number of wheels in a record."""
    return (*values, *_NOT_REPORTED)[:MOST_WHEELS]


class Measured:
    """The speeds and turns of the wheels, by wire id, as the board reports them.

    An impossible report is ignored. If a counter jumps and the next report continues from the new value, the board has
    restarted or its counters were reset. The new value is then believed, but the jump does not count as turns.
    """

    def __init__(self, reports: WheelReports, most_rps: float = 0.0, *, summed: bool = False) -> None:
        """`most_rps`: the highest speed that may be commanded, turns per second. A report far above it is not
        believed. `summed`: True if the speeds are summed up over many reports, so that each may be rough."""
        self._reports = reports
        self._fastest_rps = max(FASTEST_RPS, 4 * most_rps)
        self.counts = reports.position_per_turn > 0
        """True if the board counts turns itself. Otherwise turns are added up from its speeds, so turns between two
        reports may be lost."""
        self.step = reports.position_step / reports.position_per_turn if self.counts else 0.0
        """How many turns one count is. 0 if that is too small to matter, or if the board does not count."""
        self._apart_ns = SAME_READ_NS if summed else max(SAME_READ_NS, reports.apart_ns)
        self._jump = max(LEAST_TURN, 1.5 * self.step)
        self.t_ns = 0
        """The time when the newest believed report came, or 0 if there is none."""
        self.speeds_rps: tuple[float, ...] = ()
        """The speeds in turns per second. Empty if they are not known."""
        self.turns: tuple[float, ...] = ()
        """The turns since the first report. Empty if they are not reported."""
        self.missed = 0.0
        """How many turns a wheel may have made in gaps between reports, since the first report."""
        self._positions: tuple[float, ...] = ()
        self._strange: tuple[int, tuple[float, ...]] = (0, ())
        """The last report that was not believed, as (time, positions). The next report may continue from it."""
        self._moved: tuple[float, ...] = ()
        self._moved_ns = 0
        """The time from which `_moved` counts turns. The speeds are computed from those turns."""

    def inherit(self, turns: Sequence[float], speeds_rps: Sequence[float], t_ns: int) -> None:
        """Continue from the newest report of an earlier telemetry process."""
        self.turns, self.speeds_rps, self.t_ns = tuple(turns), tuple(speeds_rps), t_ns

    def add(self, speeds: Sequence[float], positions: tuple[float, ...], t_ns: int) -> bool:
        """Add a report of the board, in the board's own units. Returns True if this report has set `speeds_rps`."""
        told = self._reports
        rps = tuple(speed / told.speed_per_rps for speed in speeds) if told.speed_per_rps else ()
        counts = positions if self.counts else ()
        # The chained comparison is false for NaN, so a NaN is not believed.
        if not all(-self._fastest_rps <= each <= self._fastest_rps for each in rps):
            rps = ()
        if not all(map(isfinite, counts)):
            return False
        if counts:
            if not self._count(counts, t_ns):
                return False
            if not rps and t_ns - self._moved_ns >= self._apart_ns:
                rps = tuple(turns * 1e9 / (t_ns - self._moved_ns) for turns in self._moved)
            if t_ns - self._moved_ns >= self._apart_ns:
                self._moved, self._moved_ns = (0.0,) * len(counts), t_ns
        elif rps and not self.counts:
            self._add_up(rps, t_ns)
        if rps or counts:
            self.t_ns = max(self.t_ns, t_ns)
            self.speeds_rps = rps or self.speeds_rps
        return bool(rps)

    def _add_up(self, rps: tuple[float, ...], t_ns: int) -> None:
        """Add up turns from speeds, as the mean speed of two reports times the time between them."""
        if len(self.turns) != len(rps):
            self.turns = (0.0,) * len(rps)
        if self.t_ns and t_ns > self.t_ns and len(self.speeds_rps) == len(rps):
            gap_ns = t_ns - self.t_ns
            known_s = min(gap_ns, LONGEST_SILENCE_NS) * 1e-9
            pairs = zip(self.turns, self.speeds_rps, rps, strict=True)
            self.turns = tuple(turns + (before + now) / 2 * known_s for turns, before, now in pairs)
            if gap_ns > LONGEST_SILENCE_NS:
                self.missed += max(map(abs, (*self.speeds_rps, *rps)), default=0.0) * gap_ns * 1e-9

    def _count(self, positions: tuple[float, ...], t_ns: int) -> bool:
        """Add turns from the board's counters. Returns False if the report is not believed."""
        elapsed_ns = max(0, t_ns - self.t_ns)
        strange_ns, strange = self._strange
        self._strange = (0, ())
        if len(self._positions) != len(positions):
            self._begin(positions, t_ns)
            return True
        steps = self._steps(self._positions, positions)
        if self._restarted(positions, steps, elapsed_ns):
            self._lose(elapsed_ns)
            steps = (0.0,) * len(positions)
        elif not self._possible(steps, elapsed_ns):
            steps = self._steps(strange, positions) if len(strange) == len(positions) else ()
            if not steps or not self._possible(steps, max(0, t_ns - strange_ns)):
                self._strange = (t_ns, positions)
                return False
            self._lose(elapsed_ns)
        self._positions = positions
        self.turns = tuple(map(sum, zip(self.turns, steps, strict=True)))
        self._moved = tuple(map(sum, zip(self._moved, steps, strict=True)))
        return True

    def _begin(self, positions: tuple[float, ...], t_ns: int) -> None:
        if len(self.turns) == len(positions):
            self._lose(t_ns - self.t_ns)
        else:
            self.turns = (0.0,) * len(positions)
        # The first count says nothing about the speed, and the last known speed is from before a gap.
        self.speeds_rps = ()
        self._positions, self._moved, self._moved_ns = positions, (0.0,) * len(positions), t_ns

    def _lose(self, elapsed_ns: int) -> None:
        longest_s = min(max(0, elapsed_ns), 2 * LONGEST_SILENCE_NS) * 1e-9
        self.missed += max(map(abs, self.speeds_rps), default=0.0) * longest_s

    def _steps(self, before: tuple[float, ...], positions: tuple[float, ...]) -> tuple[float, ...]:
        """Return the turns between two reports."""
        told = self._reports
        steps = [now - then for now, then in zip(positions, before, strict=True)]
        if told.wraps:
            steps = [(step + told.wraps / 2) % told.wraps - told.wraps / 2 for step in steps]
        return tuple(step / told.position_per_turn for step in steps)

    def _possible(self, steps: tuple[float, ...], elapsed_ns: int) -> bool:
        most = self._fastest_rps * elapsed_ns * 1e-9 + 1.0
        return all(abs(step) <= most for step in steps)

    def _restarted(self, positions: tuple[float, ...], steps: tuple[float, ...], elapsed_ns: int) -> bool:
        """Return True if all counters are close to zero, although the wheels can't have turned them back that far."""
        if len(self.speeds_rps) != len(positions):
            return False
        short_s, elapsed_s = min(elapsed_ns, _AT_ONCE_NS) * 1e-9, elapsed_ns * 1e-9
        near = [self._jump + 2 * abs(rps) * short_s for rps in self.speeds_rps]
        at_zero = [abs(position) / self._reports.position_per_turn for position in positions]
        if any(at > most for at, most in zip(at_zero, near, strict=True)):
            return False
        if elapsed_ns > LONGEST_SILENCE_NS and not any(positions):
            return any(abs(step) > self._jump for step in steps)
        ways = [(step, rps * elapsed_s) for step, rps in zip(steps, self.speeds_rps, strict=True)]
        far = [(step, way) for step, way in ways if abs(step) > self._jump]
        return any(step * way < 0 or abs(step) > 2 * abs(way) + self._jump for step, way in far)


class Way:
    """Checks whether the wheels have really moved since they were last at rest. If a wheel rests on an edge of its
    encoder, its count may flip back and forth although the wheel does not move. This matters only if the board reports
    positions and no speeds."""

    def __init__(self, reports: WheelReports) -> None:
        self._counts = 0.0 if reports.speed_per_rps else reports.position_per_turn
        self._from: tuple[float, ...] = ()

    def went(self, turns: tuple[float, ...], *, rest: bool) -> bool:
        """Return True if a wheel has moved by at least LEAST_COUNTS since the wheels were last at rest. Also return
        True if the board reports speeds, or if it does not count turns. `turns`: the turns of each wheel. `rest`: True
        if the wheels are at rest now."""
        if not self._counts:
            return True
        if rest or len(self._from) != len(turns):
            self._from = turns
        steps = [abs(now - then) * self._counts for now, then in zip(turns, self._from, strict=True)]
        return max(steps, default=0.0) >= LEAST_COUNTS


class WheelFact:
    """Judges whether the wheels turn or are still, and since when. Call update() at each reading and at each change of
    the gate."""

    def __init__(self, after_ns: int) -> None:
        """`after_ns`: how long the wheels may turn after zero was commanded."""
        self._after_ns = after_ns
        self.does = UNKNOWN_WHEELS
        self.by = SEEN_BY_NOTHING
        self.since_ns = 0
        """The time since which the wheels have been still, or have been turning. 0 if neither is known."""
        self.read_ns = 0
        """The time when the newest reading was made, or 0 if there is none."""
        self.unexpected = False
        """True if the wheels turn although zero has been commanded for longer than allowed."""

    def update(
        self, read_back: ReadBack, still: StillJudge, told_zero_ns: int, now_ns: int, *, went: bool = True
    ) -> None:
        """Judge the wheels again. `told_zero_ns`: since when zero has been commanded, or 0 if motion is commanded.
        `went`: False if the wheels have not really moved (see Way)."""
        judge: ReadBack | StillJudge = read_back if read_back.judged_ns else still
        before = (self.does, self.by)
        self.read_ns = judge.judged_ns
        if not judge.judged_ns:
            self.does, self.by = UNKNOWN_WHEELS, SEEN_BY_NOTHING
        else:
            self.does = ARE_STILL if judge.still_ns else THEY_TURN
            self.by = SEEN_BY_REPORTS if judge is read_back else SEEN_BY_IMU
        late = told_zero_ns > 0 and self.read_ns - max(told_zero_ns, self.since_ns) >= self._after_ns
        # If the reports have ended, the last one says nothing about the present.
        self.unexpected = self.does == THEY_TURN and late and went and now_ns - self.read_ns < self._after_ns
        if before != (self.does, self.by):
            self.since_ns = judge.still_ns or judge.judged_ns or now_ns
            self.unexpected = False
