"""Wheels to judge the judge of runaway wheels: simulated ones, with drawn boards, robots, slopes, loads and reports.

A healthy wheel follows its commands as well as its drawn parameters let it, and every alarm of it is a false one. A
runaway wheel turns faster than told, the other way, or on although told zero, and must be found in its run-down time
and 0.2 s. What is healthy, and when it must be found, is written here once more from procs/telemetry/runaway.md,
because a trial that takes its bounds from the judge could only agree with it.

    python -m failstop_lab.runaway --seconds 1000000 --jobs 2
"""

from __future__ import annotations

import argparse
import json
import random
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import pi
from multiprocessing import get_context

from failstop.board.damiao.codec import LIMIT as FASTEST
from failstop.board.kinds import board_of
from failstop.board.vesc.wire import HUB_PER_RPS
from failstop.policy.settings import Settings
from failstop.procs.telemetry import runaway
from failstop.procs.telemetry.runaway import Finding, RunawayJudge

MS = 1_000_000
TICK_NS = 20 * MS
TICK_S = 0.02
EPISODE_S = 200
SLACK_NS = 200 * MS
NEVER_NS = 3_000 * MS
"""A runaway wheel that is not found so long after its bar is not found at all."""

TOO_FAST, OTHER_WAY, THOUGH_ZERO = "faster than told", "the other way", "although told zero"
FAULTS = (TOO_FAST, OTHER_WAY, THOUGH_ZERO)
SHARES = {
    "hoverboard": (0.75, 0.1),
    "arduino": (0.3, 0.05),
    "feetech": (0.3, 0.05),
    "ugv": (0.3, 0.05),
    "vesc": (0.3, 0.05),
    "damiao": (0.3, 0.05),
}
"""The documented margins: a share of what is told, and m/s at the rim."""
REPORTS_MS = {
    "hoverboard": (20, 20),
    "ugv": (50, 100),
    "feetech": (50, 125),
    "arduino": (150, 300),
    "vesc": (50, 100),
    "damiao": (50, 100),
}
"""The time between two reports: the shortest, and the longest that the page names."""
STEPS_RPS = {"hoverboard": 1 / 60, "feetech": 1 / 4096, "vesc": 1 / HUB_PER_RPS, "damiao": 2 * FASTEST / 4095 / 2 / pi}
"""The steps of reported speeds, in turns a second."""
COUNTS = (12, 20, 44, 64, 200, 360, 680, 1320, 1992, 3436)
JUDGED_BOARDS = tuple(SHARES)


@dataclass
class Robot:
    """A drawn robot; speeds in turns a second of its one wheel."""

    kind: str
    settings: Settings
    rim_m: float
    step_rps: float
    counts: float
    limit_rps: float
    ramp_rps2: float
    braking_rps2: float

    @property
    def apart_ms(self) -> float:
        """How far apart reports of positions must be to be compared: a wheel at 0.04 m/s has then moved by a count, or
        0.4 s are over."""
        return min(400.0, 1000 * self.rim_m / self.counts / 0.04) if self.counts else 0.0

    @property
    def slack_rps(self) -> float:
        """What its wheel may differ by when it is told zero, without the count of its encoder."""
        return SHARES[self.kind][1] / self.rim_m + self.step_rps

    def count_rps(self, every_ns: float) -> float:
        """What one count is in the time between two reports."""
        return 1e9 / (self.counts * every_ns) if self.counts else 0.0


def draw_robot(chance: random.Random, kind: str) -> Robot:
    """Any robot with such a board."""
    encoder = float(chance.choice((*COUNTS, chance.randrange(12, 3437)))) if kind == "arduino" else 0.0
    diameter_m = chance.uniform(0.06, 0.25)
    counts = 100 * pi * diameter_m if kind == "ugv" else encoder  # a UGV reports whole centimetres
    values: dict[str, object] = {
        "board.kind": kind,
        "wheels.diameter_m": diameter_m,
        "limits.vx_mps": chance.uniform(0.1, 1.5),
        "limits.acceleration_mps2": chance.choice((0.2, 0.5, 1.0, 3.0)),
        "limits.braking_mps2": chance.choice((0.3, 1.0, 1.0, 2.0)),
        **({"board.per_rps": encoder / 30} if encoder else {}),
    }
    settings, rim_m = Settings(values), pi * diameter_m
    step = {**STEPS_RPS, "ugv": 0.001 / rim_m}
    if encoder:
        step["arduino"] = 30 / encoder
    return Robot(
        kind=kind,
        settings=settings,
        rim_m=rim_m,
        step_rps=step[kind],
        counts=counts,
        limit_rps=settings["limits.vx_mps"] / rim_m,
        ramp_rps2=settings["limits.acceleration_mps2"] / rim_m,
        braking_rps2=settings["limits.braking_mps2"] / rim_m,
    )


class Driver:
    """What a gate tells the wheel: ramps to drawn speeds, reversals, sudden zeros, rests; it disables now and then."""

    def __init__(self, chance: random.Random, robot: Robot) -> None:
        self._chance, self._robot = chance, robot
        self._wanted = self._left_s = 0.0
        self.told = 0.0
        self.enabled = True
        self.held = False
        """Its commands stay as they are."""

    def step(self) -> None:
        """A tick of the gate."""
        if self.held:
            return
        self._left_s -= TICK_S
        if self._left_s <= 0:
            self._draw()
        if not self.enabled:
            return
        most = self._robot.ramp_rps2 * TICK_S
        self.told += max(-most, min(most, self._wanted - self.told))

    def _draw(self) -> None:
        chance, limit = self._chance, self._robot.limit_rps
        self._left_s = chance.choice((0.1, 0.3, 1.0, 3.0, 8.0)) * chance.uniform(0.5, 1.5)
        what = chance.random()
        if what < 0.04:
            self.enabled, self.told, self._wanted = False, 0.0, 0.0
            return
        self.enabled = True
        if what < 0.18:
            self.told = self._wanted = 0.0  # a driver that fell silent: no ramp
        elif what < 0.3:
            self._wanted = 0.0
        elif what < 0.5:
            self._wanted = -self._wanted
        else:
            self._wanted = chance.choice((-1, 1)) * limit * chance.choice((0.05, 0.3, 0.7, 1.0)) * chance.random()


class Wheel:
    """A healthy wheel, in turns a second: `speed` is the true one."""

    def __init__(self, chance: random.Random, robot: Robot) -> None:
        self._chance, self._robot = chance, robot
        self.speed = self.turned = 0.0
        self._rate = 0.0
        late = chance.choice((0, 1, 2, 3))
        self._coming: deque[float] = deque([0.0] * late)
        """What it was told, on its way."""
        self._voltage = robot.kind == "hoverboard"
        self._slope = 0.0
        self._gain = chance.uniform(0.5, 1.25) if self._voltage else chance.uniform(0.92, 1.08)
        self._sag = 1.0
        self._lag_s = chance.uniform(0.03, 0.3)
        self._stiff_rps = chance.choice((0.0, 0.0, 0.02, 0.05)) / robot.rim_m
        self._natural = chance.uniform(6.0, 20.0)
        self._damping = chance.uniform(0.5, 1.2)
        self._fastest = robot.braking_rps2 * chance.uniform(1.05, 6.0)
        self._rolls_out = not self._voltage and chance.random() < 0.3
        self._friction = robot.braking_rps2 * chance.uniform(0.3, 1.0)

    def step(self, told: float) -> None:
        """A tick: it is told this from now on."""
        self._coming.append(told)
        told = self._coming.popleft()
        step = self._robot.step_rps
        told = int(told / step) * step
        if self._chance.random() < 0.004:
            self._disturb(told)
        if self._voltage:
            self._set_voltage(told)
        elif self._rolls_out and not told:
            slower = self._friction * TICK_S
            self.speed -= max(-slower, min(slower, self.speed))
            self._rate = 0.0
        else:
            self._hold(told * self._gain)
        self.turned += self.speed * TICK_S

    def _disturb(self, told: float) -> None:
        chance = self._chance
        what = chance.random()
        if what < 0.3:
            self._slope = chance.uniform(-0.09, 0.09) / self._robot.rim_m
        elif what < 0.5:
            self._sag = chance.uniform(0.6, 1.17)
        elif what < 0.9:
            # A load that comes or goes; where nothing drives the wheel, it only slows it down.
            self.speed *= chance.uniform(0.3, 1.5 if told else 1.0)
        else:
            self.speed = 0.0

    def _set_voltage(self, told: float) -> None:
        aim = told * self._gain * self._sag + self._slope
        if abs(aim) < self._stiff_rps:
            aim = 0.0
        self.speed += (aim - self.speed) * min(1.0, TICK_S / self._lag_s)

    def _hold(self, aim: float) -> None:
        cap = self._robot.limit_rps * 1.2 * self._sag
        aim = max(-cap, min(cap, aim))
        pull = self._natural**2 * (aim - self.speed) - 2 * self._damping * self._natural * self._rate
        self._rate = max(-self._fastest, min(self._fastest, self._rate + pull * TICK_S))
        self.speed += self._rate * TICK_S


@dataclass
class ReportStream:
    """The board's reports of one wheel: when each arrives, and what it says."""

    chance: random.Random
    robot: Robot
    calm: bool = False
    """None is lost for long."""
    every_ns: int = 0
    _next_ns: int = 0
    _arrived_ns: int = 0
    _silent_ns: int = 0
    _uneven: bool = False
    """Other questions come between those for positions."""
    _loss: float = 0.0
    _late_ns: int = 0
    _noise: float = 0.0
    _coming: deque[tuple[int, float]] = field(default_factory=deque)

    def __post_init__(self) -> None:
        shortest, longest = REPORTS_MS[self.robot.kind]
        self.every_ns = self.chance.randrange(shortest, longest + 1) * MS
        self._uneven = self.robot.kind == "arduino" and self.chance.random() < 0.5
        self._loss = 0.0 if self.calm else self.chance.choice((0.0, 0.01, 0.1, 0.3))
        self._late_ns = self.chance.choice((1, 5, 20)) * MS
        self._noise = self.chance.choice((0.0, 0.01, 0.02))

    def step(self, wheel_rps: float, turned: float, now_ns: int) -> None:
        """Make a report when it is due."""
        if now_ns < self._next_ns:
            return
        every_ns = self.chance.choice((100, 200, 300)) * MS if self._uneven else self.every_ns
        self._next_ns = max(self._next_ns + every_ns, now_ns)
        if not self.calm and self.chance.random() < 0.0005:
            self._silent_ns = now_ns + self.chance.randrange(100, 4000) * MS
        if now_ns < self._silent_ns or self.chance.random() < self._loss:
            return
        late_ns = round(self.chance.random() ** 3 * self._late_ns)
        if not self.calm and self.chance.random() < 0.003:
            late_ns += self.chance.randrange(100) * MS
        self._arrived_ns = max(self._arrived_ns, now_ns + late_ns)
        self._coming.append((self._arrived_ns, self._said(wheel_rps, turned)))

    def _said(self, wheel_rps: float, turned: float) -> float:
        robot = self.robot
        if robot.kind == "ugv":
            return float(int(turned * robot.counts)) / robot.counts  # towards zero
        if robot.counts:
            return float(int(turned * robot.counts // 1)) / robot.counts
        noisy = wheel_rps * (1 + self._noise * self.chance.gauss(0.0, 1.0))
        unit = STEPS_RPS[robot.kind]
        return round(noisy / unit) * unit

    def arrived(self, now_ns: int) -> Iterator[tuple[int, float]]:
        """Those that have come by now."""
        while self._coming and self._coming[0][0] <= now_ns:
            yield self._coming.popleft()


class Follower:
    """It looks at every tick, and is held up now and then: what waited may count as come when it last looked."""

    def __init__(self, chance: random.Random, robot: Robot) -> None:
        board = board_of(*robot.settings.board())
        limits = runaway.limits_of(robot.settings, board)
        assert limits is not None
        self._counts = bool(robot.counts)
        self.judge = RunawayJudge(limits, (0,))
        self._chance = chance
        self._held_ns = self._looked_ns = self._told_ns = 0
        self._told = (0.0,)

    def step(self, driver: Driver, reports: ReportStream, now_ns: int, *, calm: bool = False) -> list[Finding]:
        """A tick."""
        if (driver.told,) != self._told:
            self._told, self._told_ns = (driver.told,), now_ns
        if not calm and self._chance.random() < 0.0005:
            self._held_ns = now_ns + self._chance.randrange(20, 600) * MS
        if now_ns < self._held_ns:
            return []
        waited = now_ns - self._looked_ns > 100 * MS
        before_ns, self._looked_ns = self._looked_ns, now_ns
        self.judge.follow(self._told, self._told_ns, now_ns, enabled=driver.enabled)
        found = []
        for came_ns, said in reports.arrived(now_ns):
            t_ns = before_ns if waited else came_ns
            finding = self.judge.add(() if self._counts else (said,), (said,) if self._counts else (), t_ns)
            if finding:
                found.append(finding)
        return found


@dataclass
class Outcome:
    """What came of some episodes."""

    seconds: float = 0.0
    false: list[str] = field(default_factory=list)
    stands: int = 0
    found: Counter[str] = field(default_factory=Counter)
    late: list[str] = field(default_factory=list)
    worst_ms: Counter[str] = field(default_factory=Counter)
    """The latest detection, against the bar: more than 0 is too late."""

    def add(self, other: Outcome) -> None:
        """Take in another one."""
        self.seconds += other.seconds
        self.false += other.false
        self.stands += other.stands
        self.found += other.found
        self.late += other.late
        for name, late_ms in other.worst_ms.items():
            self.worst_ms[name] = max(self.worst_ms.get(name, -(10**6)), late_ms)


def healthy(seed: str, kind: str, seconds: float) -> Outcome:
    """Drive a healthy wheel; each alarm is a false one."""
    chance = random.Random(seed)
    robot = draw_robot(chance, kind)
    driver, wheel, reports = Driver(chance, robot), Wheel(chance, robot), ReportStream(chance, robot)
    telemetry, outcome, now_ns = Follower(chance, robot), Outcome(seconds=seconds), 10**12
    for _ in range(round(seconds / TICK_S)):
        now_ns += TICK_NS
        driver.step()
        wheel.step(driver.told)
        reports.step(wheel.speed, wheel.turned, now_ns)
        for finding in telemetry.step(driver, reports, now_ns):
            if finding.what == runaway.STANDS:
                outcome.stands += 1
                continue
            at_s = (now_ns - 10**12) / 1e9
            outcome.false.append(
                f"{seed} at {at_s:.2f} s: told {finding.told_rps:.3f}, seen {finding.seen_rps:.3f}, true "
                f"{wheel.speed:.3f}, counts {robot.counts:g}, step {robot.step_rps:.3f}"
            )
    return outcome


def failing(seed: str, kind: str, fault: str) -> Outcome:
    """Drive a wheel that runs away at a drawn moment, and see how much later that is found."""
    chance = random.Random(seed)
    robot = draw_robot(chance, kind)
    driver, wheel, reports = Driver(chance, robot), Wheel(chance, robot), ReportStream(chance, robot, calm=True)
    telemetry, now_ns = Follower(chance, robot), 10**12
    share, _ = SHARES[kind]
    count_rps = robot.count_rps(max(60.0, robot.apart_ms) * MS)
    beyond = robot.slack_rps + count_rps
    driver.enabled, driver.held = True, True
    goal = robot.limit_rps * chance.uniform(0.3, 1.0)
    driver.told = goal if fault != THOUGH_ZERO else max(goal, 1.5 * beyond)
    for _ in range(round(chance.uniform(3.0, 4.0) / TICK_S)):  # up to speed
        now_ns += TICK_NS
        wheel.speed += (driver.told - wheel.speed) * 0.1
        wheel.turned += wheel.speed * TICK_S
        reports.step(wheel.speed, wheel.turned, now_ns)
        telemetry.step(driver, reports, now_ns, calm=True)
    before, fault_ns, times = driver.told, now_ns, chance.uniform(1.25, 4.0)
    if fault == TOO_FAST:
        speed = (driver.told * (1 + share) + beyond) * times
    elif fault == OTHER_WAY:
        speed = -beyond * times
    else:
        speed, driver.told = max(wheel.speed, beyond * 1.25), 0.0
    rolls_s = before / robot.braking_rps2
    bar_ns = round((0.3 + 0.2 + rolls_s) * 1e9) + round(3 * (REPORTS_MS[kind][1] + robot.apart_ms) * MS) + SLACK_NS
    name = f"{kind}: {fault}"
    while now_ns - fault_ns < bar_ns + NEVER_NS:
        now_ns += TICK_NS
        wheel.speed = speed
        wheel.turned += speed * TICK_S
        reports.step(speed, wheel.turned, now_ns)
        findings = telemetry.step(driver, reports, now_ns, calm=True)
        if any(finding.what == runaway.RAN_AWAY for finding in findings):
            late_ms = (now_ns - fault_ns - bar_ns) // MS
            outcome = Outcome(found=Counter({name: 1}), worst_ms=Counter({name: late_ms}))
            if late_ms > 0:
                outcome.late.append(f"{seed} {name}: {late_ms} ms after its bar")
            return outcome
    return Outcome(late=[f"{seed} {name}: not found (told {before:.3f}, {speed:.3f}, counts {robot.counts:g})"])


def _episode(what: tuple[str, str, str]) -> Outcome:
    seed, kind, fault = what
    return failing(seed, kind, fault) if fault else healthy(seed, kind, EPISODE_S)


def trials(seconds: float, seed: str = "runaway") -> Iterator[tuple[str, str, str]]:
    """Healthy wheels for so long in all, and as many runaway ones as episodes."""
    for number in range(max(1, round(seconds / EPISODE_S))):
        kind = JUDGED_BOARDS[number % len(JUDGED_BOARDS)]
        yield f"{seed}-{number}", kind, ""
        yield f"{seed}-fault-{number}", kind, FAULTS[number // len(JUDGED_BOARDS) % len(FAULTS)]


def campaign(seconds: float, jobs: int = 1, seed: str = "runaway") -> Outcome:
    """Run them all."""
    outcome = Outcome()
    if jobs == 1:
        for what in trials(seconds, seed):
            outcome.add(_episode(what))
        return outcome
    with get_context("fork").Pool(jobs) as pool:
        for found in pool.imap_unordered(_episode, trials(seconds, seed), chunksize=8):
            outcome.add(found)
    return outcome


def main(argv: list[str] | None = None) -> int:
    """Print what came of it as JSON; exit code 1 where a bar was missed."""
    parser = argparse.ArgumentParser(prog="python -m failstop_lab.runaway", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=10_000.0, help="simulated seconds of healthy wheels")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", default="runaway")
    options = parser.parse_args(argv)
    outcome = campaign(options.seconds, options.jobs, options.seed)
    print(
        json.dumps(
            {
                "seconds": outcome.seconds,
                "false_alarms": len(outcome.false),
                "stands_warnings": outcome.stands,
                "found": dict(sorted(outcome.found.items())),
                "latest_against_bar_ms": dict(sorted(outcome.worst_ms.items())),
                "missed_or_late": len(outcome.late),
                "examples": (outcome.false + outcome.late)[:20],
            },
            indent=1,
        )
    )
    return bool(outcome.false or outcome.late)


if __name__ == "__main__":
    raise SystemExit(main())
