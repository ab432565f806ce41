"""Runaway: detects from the board's reports that a wheel does not follow its commands. Pure.

Each report is compared with all speeds that were commanded in the time that the report may describe. A wheel that turns
faster than these speeds, or the wrong way, gets time to slow down. If the wheel has not slowed down by then, it has run
away. A wheel that stands still although it should turn only causes a warning, unless the board controls its speed by
counts: if a wheel is not counted, such a board turns it faster and faster. procs/telemetry/runaway.md explains the
thresholds.
"""

from __future__ import annotations

from collections import deque
from math import pi

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Board
    from failstop.policy.settings import Settings

    Told = tuple[float, ...]

RAN_AWAY, STANDS, NOT_COUNTED = "ran away", "stands", "is not counted"

LAG_NS = 300_000_000
"""How long after a new command the wheels may still do what was commanded before. It covers the time until the command
reaches the board, the delay of the board's controller, and a late report."""
BEYOND_NS = 200_000_000
"""A wheel can count as run away only if it was faster than commanded, or turned in the other direction, for at least
this long (in ns) and in at least LEAST_REPORTS reports."""
LEAST_REPORTS = 3
UNFOLLOWED_NS = 150_000_000
"""If follow() was not called for longer than this, in ns, nobody knows what was commanded meanwhile, so everything is
forgotten."""
SLOWS = 0.92
"""A wheel that has been too fast for some time is slowing down if its speed in the second half of that time is below
this share of its speed in the first half. It then only rolls out, and has not run away."""
HELD_BACK_NS = 20_000_000
"""How late a serial adapter may deliver a report, in ns (its latency timer). If the reports are positions, a late
report makes the next speed seem higher than it is."""
STANDS_NS = 3_000_000_000
"""A wheel that does not turn for this long although motion is commanded is stalled or unplugged."""
STANDS_SHARE = 0.1
STANDS_MPS = 0.02
"""A commanded speed below this may be too low to move the wheel."""
UNCOUNTED_NS = 1_000_000_000
"""A wheel that is not counted for this long (in ns), and for so many commanded turns that its encoder should have had
LEAST_UNCOUNTED counts, has a dead encoder or is blocked."""
LEAST_UNCOUNTED = 5.0
SELDOM_NS = 1_000_000_000
"""A board that reports less often than this, or whose description does not say how often it reports, is not judged."""


class Margins(Data):
    """How much a wheel's speed may differ from the commanded one."""

    share: float
    """How much faster than commanded the wheel may turn, as a share of the commanded speed."""
    rim_mps: float
    """A further difference that is allowed, in either direction: a speed of the wheel's rim, m/s."""


HOLDS_SPEED = Margins(0.3, 0.05)
"""The margins for a board that measures and controls the wheels' speeds."""
SETS_VOLTAGE = Margins(0.75, 0.1)
"""The margins for a board that sets a voltage. Its wheels turn faster downhill and with a full battery, and roll back
on a slope."""


class Limits(Data):
    """The thresholds for one robot."""

    every_ns: int
    """The longest time between two reports that are judged."""
    share: float
    rps: float
    """The allowed difference that does not depend on the command, in turns per second. It is the sum of
    Margins.rim_mps, as turns per second, and the step to which the board rounds commands. A speed below this counts as
    zero."""
    counts: float
    """Counts per turn of a wheel, or 0 if the board reports speeds."""
    braking_rps2: float
    """How fast a wheel slows down at least, in turns per second squared."""
    told_rps: float
    """A wheel may stand still if its commanded speed is below this, in turns per second."""
    apart_ns: int = 0
    """Reports of positions that are closer together than this, in ns, are not judged."""
    by_counts: bool = False
    """True if the board controls the wheels' speeds by the counts that it reports."""

    def rolls_ns(self, told_rps: float) -> int:
        """Return how long, in ns, a wheel may turn too fast before it can count as run away. This is BEYOND_NS plus the
        time to slow down from `told_rps`."""
        return BEYOND_NS + round(abs(told_rps) / self.braking_rps2 * 1e9)


def limits_of(settings: Settings, board: Board) -> Limits | None:
    """Return the thresholds for this robot, or None if its board does not report often enough to be judged."""
    reports, rim_m = board.reports, pi * settings["wheels.diameter_m"]
    if not 0 < reports.every_ns < SELDOM_NS or not (reports.speed_per_rps or reports.position_per_turn):
        return None
    margins = HOLDS_SPEED if reports.holds_speed else SETS_VOLTAGE
    counts = 0.0 if reports.speed_per_rps else reports.position_per_turn
    return Limits(
        every_ns=reports.judged_ns,
        share=margins.share,
        rps=margins.rim_mps / rim_m + board.step_rps,
        counts=counts,
        braking_rps2=settings["limits.braking_mps2"] / rim_m,
        told_rps=STANDS_MPS / rim_m + 2 * board.step_rps,
        apart_ns=max(reports.every_ns // 4, reports.apart_ns),
        by_counts=reports.holds_speed and counts > 0,
    )


class Finding(Data):
    """A wheel that does not turn as commanded. Both speeds are in turns per second, with the sign that the board
    uses."""

    what: str
    """RAN_AWAY, STANDS or NOT_COUNTED."""
    wheel: int
    """The wheel's id on the wire."""
    told_rps: float
    seen_rps: float


class _Wheel:
    """The judge's memory of one wheel: since when the wheel has turned too fast or the wrong way, and since when it has
    stood still."""

    __slots__ = (
        "before_rps",
        "beyond_ns",
        "halves",
        "last_ns",
        "reports",
        "rolls_ns",
        "second_ns",
        "side",
        "stand_noted",
        "stands_ns",
        "uncounted",
        "uncounted_ns",
    )

    def __init__(self) -> None:
        self.beyond_ns = self.last_ns = self.rolls_ns = self.reports = self.second_ns = self.side = self.stands_ns = 0
        self.counted()
        self.before_rps = 0.0
        """The fastest speed that was commanded since the wheel last turned as commanded."""
        self.halves = [0.0, 0.0, 0.0, 0.0]
        """Four sums over the reports of a wheel that turns too fast or the wrong way. The first two are for the reports
        until `second_ns`: the sum of speed times weight, and the sum of the weights. The last two are the same sums for
        the later reports."""
        self.stand_noted = False
        """True if it was already reported that the wheel stands still."""

    def counted(self) -> None:
        self.uncounted, self.uncounted_ns = 0.0, 0
        """How many turns were commanded at least since the wheel was last counted, and in how many ns."""

    def within(self) -> None:
        self.beyond_ns, self.before_rps = 0, 0.0

    def begin(self, side: int, since_ns: int, rolls_ns: int, every_ns: int) -> None:
        """Record that the wheel turns too fast or the wrong way from `since_ns` on. `side`: 1 if its speed is too high,
        -1 if it is too low. `rolls_ns`: how long this may last before the wheel counts as run away. `every_ns`: the
        time between two reports."""
        self.side, self.beyond_ns, self.rolls_ns, self.reports = side, since_ns, rolls_ns, 0
        self.second_ns = since_ns + max(rolls_ns // 2, every_ns + every_ns // 4)
        self.halves = [0.0, 0.0, 0.0, 0.0]

    def add(self, seen_rps: float, weight: float, t_ns: int) -> None:
        """Add a report of a wheel that turns too fast or the wrong way. `weight`: the time that the report covers,
        ns."""
        self.reports += 1
        half = 2 * (t_ns > self.second_ns)
        self.halves[half] += seen_rps * weight
        self.halves[half + 1] += weight

    def slows(self, count: float, late_ns: int) -> bool:
        """Return True if the wheel certainly slows down (see SLOWS), or if one of the two halves has no report. It is
        certain if the errors of the reports can't explain the lower speed. `count`: the error of one count of the
        encoder, in the unit of `halves` (turns per second times ns). `late_ns`: how late a report may be."""
        way, weight, later_way, later_weight = self.halves
        if not weight or not later_weight:
            return True
        return (abs(later_way) + count) / later_weight < SLOWS * abs(way) / (weight + late_ns)


class RunawayJudge:
    """Judges whether the wheels follow their commands. Call follow() with the commanded speeds at each turn, and add()
    for each report of the board, in order of time."""

    def __init__(self, limits: Limits, wheels: Sequence[int]) -> None:
        """`wheels`: the wire ids of the robot's wheels."""
        self._limits = limits
        self._wheels = {wheel: _Wheel() for wheel in wheels}
        self._told: deque[tuple[int, Told]] = deque()
        """The commanded speeds, each with the time from which they count. The oldest entry is older than any report
        that may still come."""
        self._followed_ns = 0
        self._read_ns = 0
        self._turns: Told = ()
        self._moves = False
        """True from the time when motion is commanded until a report shows the wheels at rest while zero is
        commanded."""

    def follow(self, told_rps: Told, since_ns: int, now_ns: int, *, enabled: bool) -> None:
        """Record the speeds that are commanded from `since_ns` on, in turns per second by wire id. If motion is not
        `enabled`, forget all commands, so that nothing is judged."""
        if not enabled or now_ns - self._followed_ns > UNFOLLOWED_NS:
            self._forget(now_ns)
        self._followed_ns = now_ns
        if not enabled:
            return
        told = self._told
        if not told:
            told.append((now_ns, told_rps))
        elif told[-1][1] != told_rps:
            told.append((max(since_ns, told[-1][0]), told_rps))
        self._moves = self._moves or any(told_rps)
        while len(told) > 1 and told[1][0] < now_ns - 2 * (LAG_NS + self._limits.every_ns):
            _, before = told.popleft()
            for index, wheel in self._wheels.items():
                wheel.before_rps = max(wheel.before_rps, abs(before[index]))

    def _forget(self, now_ns: int) -> None:
        for index, wheel in self._wheels.items():
            wheel.before_rps = max(wheel.before_rps, self._fastest(index))
            wheel.beyond_ns = wheel.stands_ns = 0
            wheel.counted()
            wheel.stand_noted = False
        self._told.clear()
        self._moves = False
        self._read_ns, self._turns = now_ns, ()

    def _fastest(self, index: int) -> float:
        """Return the fastest speed that was recently commanded for this wheel."""
        return max((abs(told[index]) for _, told in self._told if index < len(told)), default=0.0)

    def add(self, speeds_rps: Told, turns: Told, t_ns: int) -> Finding | None:
        """Add a report: the speed of each wheel in turns per second, or how far each has turned, by wire id. Returns
        the first wheel that has run away, or stands still although it should turn. Returns None if all is well or
        nothing can be said. A wheel that has run away is returned again if it still has not slowed down after
        Limits.rolls_ns()."""
        limits = self._limits
        begun_ns, blur_rps = t_ns - limits.every_ns, limits.rps
        if limits.counts:
            elapsed_ns, before = t_ns - self._read_ns, self._turns
            # Reports that were held up come together, so nobody knows when each was made.
            if len(before) == len(turns) and elapsed_ns < limits.apart_ns:
                return None
            begun_ns, self._read_ns, self._turns = self._read_ns, t_ns, turns
            if len(before) != len(turns):
                return None
            speeds_rps = tuple([(now - then) * 1e9 / elapsed_ns for now, then in zip(turns, before, strict=True)])
            blur_rps += 1e9 / (limits.counts * elapsed_ns)
        if not self._told or begun_ns - LAG_NS < self._told[0][0]:
            return None  # the commands of that time are not known
        found, rests = None, True
        for index, wheel in self._wheels.items():
            if index < len(speeds_rps):
                lowest, highest = self._bounds(index, begun_ns - LAG_NS)
                finding = self._judge(index, wheel, speeds_rps[index], (lowest, highest, blur_rps), (begun_ns, t_ns))
                found = found or finding
                rests = rests and abs(speeds_rps[index]) <= blur_rps and lowest == highest == 0.0
        if rests:
            self._moves = False
        return found

    def _bounds(self, index: int, since_ns: int) -> tuple[float, float]:
        """Return the lowest and the highest speed that were commanded for this wheel since `since_ns`."""
        lowest = highest = self._told[-1][1][index]
        for at in range(len(self._told) - 2, -1, -1):
            if self._told[at + 1][0] <= since_ns:
                break
            speed = self._told[at][1][index]
            lowest, highest = min(lowest, speed), max(highest, speed)
        return lowest, highest

    def _judge(
        self, index: int, wheel: _Wheel, seen: float, bounds: tuple[float, float, float], span: tuple[int, int]
    ) -> Finding | None:
        (lowest, highest, blur), (begun_ns, t_ns), limits = bounds, span, self._limits
        most = max(highest, 0.0) * (1.0 + limits.share) + blur
        least = min(lowest, 0.0) * (1.0 + limits.share) - blur
        side = (seen > most) - (seen < least)
        if not side or not self._moves:
            wheel.within()
        else:
            if side != wheel.side or not wheel.beyond_ns or t_ns - wheel.last_ns > self._gap_ns():
                wheel.before_rps = max(wheel.before_rps, self._fastest(index))
                since_ns = begun_ns if limits.counts else t_ns
                wheel.begin(side, since_ns, limits.rolls_ns(wheel.before_rps), limits.every_ns)
            wheel.add(seen, t_ns - begun_ns, t_ns)
            if t_ns - wheel.beyond_ns >= wheel.rolls_ns and wheel.reports >= LEAST_REPORTS:
                if not wheel.slows(*((1e9 / limits.counts, HELD_BACK_NS) if limits.counts else (0.0, 0))):
                    wheel.beyond_ns = 0
                    return Finding(RAN_AWAY, index, self._told[-1][1][index], seen)
                wheel.begin(side, t_ns, wheel.rolls_ns, limits.every_ns)  # it slows down, so it gets as long again
        wheel.last_ns = t_ns
        return self._stands(index, wheel, seen, bounds, span)

    def _uncounted(self, wheel: _Wheel, seen: float, told: float, elapsed_ns: int) -> bool:
        """Count how long a wheel has not been counted. Returns True if it is too long."""
        if seen or told < self._limits.told_rps:
            wheel.counted()
            return False
        wheel.uncounted += told * elapsed_ns * 1e-9
        wheel.uncounted_ns += elapsed_ns
        return wheel.uncounted_ns >= UNCOUNTED_NS and wheel.uncounted * self._limits.counts >= LEAST_UNCOUNTED

    def _gap_ns(self) -> int:
        """Return the longest allowed gap, in ns, between two reports of a wheel that turns too fast. After a longer
        gap, the time in which the wheel turns too fast is counted from the beginning again. Positions allow a longer
        gap, because they show how far the wheel has turned in the gap."""
        return BEYOND_NS + 2 * self._limits.every_ns if self._limits.counts else BEYOND_NS

    def _stands(
        self, index: int, wheel: _Wheel, seen: float, bounds: tuple[float, float, float], span: tuple[int, int]
    ) -> Finding | None:
        lowest, highest, _ = bounds
        told = max(lowest, -highest)  # the slowest commanded speed, if both have the same sign
        if self._limits.by_counts and self._uncounted(wheel, seen, told, span[1] - span[0]):
            wheel.counted()
            return Finding(NOT_COUNTED, index, self._told[-1][1][index], seen)
        if told < self._limits.told_rps or abs(seen) > STANDS_SHARE * told:
            wheel.stands_ns, wheel.stand_noted = 0, False
            return None
        wheel.stands_ns = wheel.stands_ns or span[0]
        if wheel.stand_noted or span[1] - wheel.stands_ns < STANDS_NS:
            return None
        wheel.stand_noted = True
        return Finding(STANDS, index, self._told[-1][1][index], seen)
