"""Wheels: what is known about the wheels now, from the board's reports, or from the IMU if there are none. Pure.

Every screen shows this one fact: the wheels turn, they are still, or nobody knows. The board's own reports count first,
because an IMU only feels that the robot moves, or is being moved.
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
"""A change of fewer counts is the jitter of an encoder at rest."""
FASTEST_RPS = 50.0
"""No wheel turns this fast, in turns per second (12 m/s with a wheel of 8 cm), so faster reports are not believed."""
LEAST_TURN = 0.02
"""A change of less than this, in turns, does not count as a jump of a counter (5 mm with a wheel of 8 cm)."""
LONGEST_SILENCE_NS = 500_000_000
"""After a longer silence of the board nobody knows how a wheel turned in it, unless the board counts turns."""
SAME_READ_NS = 5_000_000
"""Reports that are closer together than this came in one read, so their times say nothing about speed."""
_AT_ONCE_NS = 250_000_000
"""A counter that has started at zero has counted for at most this long before it is first read."""


def of_every_wheel(values: Sequence[float]) -> tuple[float, ...]:
    """These values, filled up with NaN to the number of wheels that a record has."""
    return (*values, *_NOT_REPORTED)[:MOST_WHEELS]


class Measured:
    """Speeds and turns of the wheels by wire id, as the board reports them.

    An impossible report counts as not reported. If a counter jumps and the next report goes on from the new value, the
    new value is believed, but the jump does not count as turns: the board has restarted, or somebody has reset its
    counters.
    """

    def __init__(self, reports: WheelReports, most_rps: float = 0.0) -> None:
        """`most_rps`: the highest speed that may be commanded, in turns per second; a report far above it is not
        believed."""
        self._reports = reports
        self._fastest_rps = max(FASTEST_RPS, 4 * most_rps)
        self.counts = reports.position_per_turn > 0
        """True if the board counts turns itself. Otherwise turns are added up from its speeds, so that turns between
        reports can be lost."""
        self.step = reports.position_step / reports.position_per_turn if self.counts else 0.0
        """Turns between two counts; 0: too small to matter."""
        self._jump = max(LEAST_TURN, 1.5 * self.step)
        self.t_ns = 0
        """When the newest report came that counts; 0: none yet."""
        self.speeds_rps: tuple[float, ...] = ()
        """Turns per second; empty: not known."""
        self.turns: tuple[float, ...] = ()
        """Turns since the first report; empty: not reported."""
        self.missed = 0.0
        """How many turns a wheel may have made unseen since the first report, in all gaps together."""
        self._positions: tuple[float, ...] = ()
        self._strange: tuple[int, tuple[float, ...]] = (0, ())
        """A report that may begin a new count: its time and its positions."""
        self._moved: tuple[float, ...] = ()
        self._moved_ns = 0
        """Since when the turns are counted from which the speeds are computed."""

    def inherit(self, turns: Sequence[float], speeds_rps: Sequence[float], t_ns: int) -> None:
        """Continue from the newest report of an earlier run of this process."""
        self.turns, self.speeds_rps, self.t_ns = tuple(turns), tuple(speeds_rps), t_ns

    def add(self, speeds: Sequence[float], positions: tuple[float, ...], t_ns: int) -> bool:
        """Add a report of the board, in its own units. True if `speeds_rps` was measured with this report; otherwise it
        is older."""
        told = self._reports
        rps = tuple(speed / told.speed_per_rps for speed in speeds) if told.speed_per_rps else ()
        counts = positions if self.counts else ()
        # A chained comparison is false for NaN.
        if not all(-self._fastest_rps <= each <= self._fastest_rps for each in rps):
            rps = ()
        if not all(map(isfinite, counts)):
            return False
        if counts:
            if not self._count(counts, t_ns):
                return False
            if not rps and t_ns - self._moved_ns >= SAME_READ_NS:
                rps = tuple(turns * 1e9 / (t_ns - self._moved_ns) for turns in self._moved)
            if t_ns - self._moved_ns >= SAME_READ_NS:
                self._moved, self._moved_ns = (0.0,) * len(counts), t_ns
        elif rps and not self.counts:
            self._add_up(rps, t_ns)
        if rps or counts:
            self.t_ns = max(self.t_ns, t_ns)
            self.speeds_rps = rps or self.speeds_rps
        return bool(rps)

    def _add_up(self, rps: tuple[float, ...], t_ns: int) -> None:
        """Add turns from speeds: the mean of two reports times the time between them."""
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
        """Add turns from counters; False if the report is not believed."""
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
        # The first count says nothing about the speed, and the last known one is from before a gap.
        self.speeds_rps = ()
        self._positions, self._moved, self._moved_ns = positions, (0.0,) * len(positions), t_ns

    def _lose(self, elapsed_ns: int) -> None:
        longest_s = min(max(0, elapsed_ns), 2 * LONGEST_SILENCE_NS) * 1e-9
        self.missed += max(map(abs, self.speeds_rps), default=0.0) * longest_s

    def _steps(self, before: tuple[float, ...], positions: tuple[float, ...]) -> tuple[float, ...]:
        """Turns between two reports."""
        told = self._reports
        steps = [now - then for now, then in zip(positions, before, strict=True)]
        if told.wraps:
            steps = [(step + told.wraps / 2) % told.wraps - told.wraps / 2 for step in steps]
        return tuple(step / told.position_per_turn for step in steps)

    def _possible(self, steps: tuple[float, ...], elapsed_ns: int) -> bool:
        most = self._fastest_rps * elapsed_ns * 1e-9 + 1.0
        return all(abs(step) <= most for step in steps)

    def _restarted(self, positions: tuple[float, ...], steps: tuple[float, ...], elapsed_ns: int) -> bool:
        """True if all counters are close to zero although the wheels were not turning towards zero."""
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
    """How far the wheels have gone since they were last at rest, if the board reports positions. A count that flips
    because the encoder stands on an edge is not a way."""

    def __init__(self, reports: WheelReports) -> None:
        self._counts = 0.0 if reports.speed_per_rps else reports.position_per_turn
        self._from: tuple[float, ...] = ()

    def went(self, turns: tuple[float, ...], *, rest: bool) -> bool:
        """True if they have gone further than such a flip explains, or if no positions are known. `turns`: the turns of
        each wheel; `rest`: the wheels are at rest now."""
        if not self._counts:
            return True
        if rest or len(self._from) != len(turns):
            self._from = turns
        steps = [abs(now - then) * self._counts for now, then in zip(turns, self._from, strict=True)]
        return max(steps, default=0.0) >= LEAST_COUNTS


class WheelFact:
    """What is known about the wheels, and since when. Call update() at each reading and at each change of the gate."""

    def __init__(self, after_ns: int) -> None:
        """`after_ns`: how long wheels may turn after they were told zero."""
        self._after_ns = after_ns
        self.does = UNKNOWN_WHEELS
        self.by = SEEN_BY_NOTHING
        self.since_ns = 0
        """Since when the wheels do what they do now; 0 if not known."""
        self.read_ns = 0
        """When the newest reading was made; 0: never."""
        self.unexpected = False
        """True if the wheels turn although they were told zero for longer than allowed."""

    def update(
        self, read_back: ReadBack, still: StillJudge, told_zero_ns: int, now_ns: int, *, went: bool = True
    ) -> None:
        """Judge again. `told_zero_ns`: since when the wheels are told zero; 0: they are told to turn. `went`: True if
        they have moved further than an encoder explains that flips on the edge of a count."""
        judge: ReadBack | StillJudge = read_back if read_back.judged_ns else still
        before = (self.does, self.by)
        self.read_ns = judge.judged_ns
        if not judge.judged_ns:
            self.does, self.by = UNKNOWN_WHEELS, SEEN_BY_NOTHING
        else:
            self.does = ARE_STILL if judge.still_ns else THEY_TURN
            self.by = SEEN_BY_REPORTS if judge is read_back else SEEN_BY_IMU
        late = told_zero_ns > 0 and self.read_ns - max(told_zero_ns, self.since_ns) >= self._after_ns
        # Reports that have ended say nothing about now.
        self.unexpected = self.does == THEY_TURN and late and went and now_ns - self.read_ns < self._after_ns
        if before != (self.does, self.by):
            self.since_ns = judge.still_ns or judge.judged_ns or now_ns
            self.unexpected = False
