"""One fault from enable to enable, judged; and a campaign of random ones."""

from __future__ import annotations

import contextlib
import dataclasses
import random
import subprocess
import time
from collections.abc import Callable, Iterator

from failstop.api.errors import FailstopError, Refused
from failstop.policy.causes import Cause
from failstop_lab.faults import arm
from failstop_lab.faults.arm_table import ArmFault
from failstop_lab.faults.fault import BY_ITSELF, BY_RESET, CRASH, HANG, KILL, SPIN, Fault, fits, in_words
from failstop_lab.faults.injectors import injector
from failstop_lab.faults.judge import verdict
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.steps import NotAtOnce
from failstop_lab.sim.client import Event, SimBoardError
from failstop_lab.trial import Stopped, TrialError

Row = Fault | ArmFault
LIMITS = ((-0.2, 0.2), (-0.2, 0.2), (-1.0, 1.0))
SLOWEST = (0.01, 0.1)
"""Forward and turn, below which a board with a coarse unit is told zero."""
BEFORE_S = (0.02, 0.12)
"""How long the wheels turn before the fault: a random moment of the 20 ms tick."""
AFTER_RESET_S = 0.03
SEEN_S = 3.0
SETUPS = 3
EXIT_CODES = {"service-stopped": 0, "names-removed": 1}
"""The exit code of a service that ends by itself, by the row's injector."""
STORY_BEFORE = 5
STORY_AFTER = 20


@dataclasses.dataclass
class Outcome:
    """The outcome of one injection. `wrong` is empty when all was as the row says."""

    fault: Row
    index: int
    stopped: Stopped | None = None
    skipped: str = ""
    wrong: list[str] = dataclasses.field(default_factory=list)
    events: list[Event] = dataclasses.field(default_factory=list)
    said: str = ""
    took_s: float = 0.0
    struck: bool = True
    """The fault was made to happen, or at least begun."""
    again: tuple[str, ...] = ()
    """Why each scene before this one ended before its fault, so that a new one was begun."""

    def story(self, seed: object) -> str:
        """All that is known of one that went wrong."""
        fault_ns = self.stopped.fault_ns if self.stopped else 0
        lines = [f"{self.fault.name} (index {self.index}, seed {seed}): {'; '.join(self.wrong)}"]
        lines.append(f"  cause: {self.fault.cause}; first to stop: {self.fault.first}")
        lines.append("  the board, ms from the fault:")
        lines += [_line_on(event, fault_ns) for event in self._around(fault_ns)]
        lines.append("  the service:")
        lines += [f"    {line}" for line in self.said.splitlines()]
        return "\n".join(lines)

    def _around(self, fault_ns: int) -> list[Event]:
        """The events around the fault, and those around the first stop after it."""
        after = next((n for n, event in enumerate(self.events) if event.arrival_ns >= fault_ns), len(self.events))
        stop = next((n for n, event in enumerate(self.events) if n >= after and event.is_stop), after)
        first, second = (range(max(0, at - STORY_BEFORE), at + STORY_AFTER) for at in (after, stop))
        return [event for n, event in enumerate(self.events) if n in first or n in second]


def _line_on(event: Event, fault_ns: int) -> str:
    kind = "STOP" if event.is_stop else "MOTION" if event.is_motion else f"func {event.func}"
    wheels = " ".join(f"{speed:+.2f}" for speed in event.speeds)
    return f"    {(event.arrival_ns - fault_ns) / 1e6:+9.2f} {kind:<6} {event.data.hex()} wheels {wheels}"


class _Injection:
    """One fault on its way through the scene."""

    def __init__(self, scene: Scene, fault: Fault, outcome: Outcome, seen_s: float) -> None:
        self._seen_s = seen_s
        self.scene = scene
        self.fault = fault
        self.outcome = outcome
        self.injector = injector(fault)
        self.pids: dict[str, int] = {}
        self.mark = 0
        self.latched: Cause | None = None
        self._fault_ns = 0
        """When the fault began (CLOCK_MONOTONIC); 0: it has not."""

    def run(self) -> None:
        """From enable to just before the next one; whatever is wrong goes into the outcome. Whatever fails on the way,
        the board has its word about the stop."""
        try:
            self._run()
        finally:
            if self.outcome.stopped is None:
                self._judge()

    def _run(self) -> None:
        scene, fault = self.scene, self.fault
        scene.driver.velocity = _velocity(scene.chance)
        scene.driver.enable()
        self.mark = scene.service.written()
        try:
            self.injector.prepare(scene)
            self.pids = scene.service.pids()
            scene.driver.until("the wheels to turn", scene.trial.turning)
            scene.driver.run(scene.chance.uniform(*BEFORE_S))
            self._see()
            scene.was_turning = scene.trial.turning()
            if not scene.was_turning:
                raise TrialError("the wheels were not turning before the fault")
            self.outcome.struck = True
            self._fault_ns = self.injector.strike(scene)
            scene.driver.each = lambda: self.injector.during(scene)
            scene.driver.run(fault.aftermath_s)
            self._meanwhile()
        finally:
            scene.driver.each = lambda: None
            if fault.cleared == BY_ITSELF:
                self._judge()
            self.injector.heal(scene)
        self._recover()

    def _see(self) -> None:
        self.outcome.events += self.scene.board.events()

    def _judge(self) -> None:
        fault_ns = self._fault_ns
        if not fault_ns:
            return
        self._see()
        events = self.outcome.events
        self.outcome.stopped, wrong = verdict(self.fault, events, fault_ns, self.scene.was_turning)
        self.outcome.wrong += wrong
        stop_ns = self.outcome.stopped.stop_ns
        if self.fault.stop_tool and self.fault.at_once and stop_ns is not None:
            early_ms = (self.scene.tool_ns - fault_ns - stop_ns) / 1e6
            if early_ms > 0.0:
                self.outcome.wrong.append(f"stopped {early_ms:.1f} ms before the stop tool was started")

    def _check(self, what: str, check: Callable[[], bool]) -> None:
        """Something that must come to be; the clients go on commanding until it does."""
        with self._noting():
            self.scene.driver.until(what, check, self._seen_s)

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """A TrialError within goes into the outcome, and the judging goes on."""
        try:
            yield
        except TrialError as error:
            self.outcome.wrong.append(str(error))

    def _meanwhile(self) -> None:
        """At the end of the fault, before it is healed."""
        scene, fault = self.scene, self.fault
        if fault.stop_tool:
            with self._noting():
                scene.wait_for_stop_tool()
        if fault.link:
            self._check(
                f"the link to be shown {fault.link}", lambda: scene.driver.robot.state.device.link == fault.link
            )
        if fault.bar_ms is None and not scene.trial.turning():
            self.outcome.wrong.append("the wheels stand, and nothing was to stop them")

    def _recover(self) -> None:
        """Until the service is whole again, with what it says, what it latched, and what clears that."""
        scene, fault = self.scene, self.fault
        if fault.survives:
            scene.driver.until("the service to be whole", self._whole, scene.whole_s)
        else:
            self._end_run()
        if fault.latched:
            self._check(f"a latch: {in_words(fault.latched)}", self._latched)
            self._check_latch()
        elif reason := scene.driver.robot.state.estop:
            self.outcome.wrong.append(f"latched: {reason}")
        self._check(f"the service to say {fault.logged or 'what is latched'!r}", self._logged)
        if fault.cleared == BY_RESET:
            self._check("the reset", self._reset)
        if fault.cleared == BY_ITSELF:
            self._check("the wheels to turn again by themselves", scene.trial.turning)
        else:
            scene.driver.run(AFTER_RESET_S)
            self._check("the wheels to stand", lambda: not scene.trial.turning())
            self._check("blocked: disabled", lambda: scene.driver.robot.state.blocked == "disabled")

    def _end_run(self) -> None:
        service = self.scene.service
        if self.fault.injector in EXIT_CODES and service.process:
            code = service.process.wait(SEEN_S)
            if code != EXIT_CODES[self.fault.injector]:
                self.outcome.wrong.append(f"the service ended with exit code {code}")
        self.scene.restart()

    def _whole(self) -> bool:
        state = self.scene.driver.robot.state
        again = self.fault.struck(KILL, CRASH, SPIN, *([HANG] if self.fault.fences else []))
        return state.waiting_for is None and not any(state.processes[p].pid == self.pids.get(p) for p in again)

    def _logged(self) -> bool:
        self.outcome.said = self.scene.service.said(self.mark)
        latched = [f"STOP latched: {self.latched}"] if self.latched else []
        return all(text in self.outcome.said for text in (self.fault.logged, *latched))

    def _latched(self) -> bool:
        self.latched = self.scene.driver.robot.state.cause
        return fits(self.latched, self.fault.latched)

    def _check_latch(self) -> None:
        """A latched stop refuses to be enabled."""
        with contextlib.suppress(Refused):
            self.scene.driver.robot.enable()
            self.outcome.wrong.append("enabled while latched")

    def _reset(self) -> bool:
        self.scene.driver.robot.reset()
        return self.scene.driver.robot.state.estop is None


def _velocity(chance: random.Random) -> tuple[float, float, float]:
    while True:
        vx, vy, wz = (chance.uniform(*limit) for limit in LIMITS)
        if abs(vx) > SLOWEST[0] or abs(wz) > SLOWEST[1]:
            return vx, vy, wz


def inject_one(scene: Scene, fault: Row, index: int = 0, seed: object = 0, *, seen_s: float = SEEN_S) -> Outcome:
    """Inject one fault and judge it; what the row says must be seen within `seen_s`. After a fault that went wrong, the
    next one gets a new scene. A robot that was stopped before the fault is driven again, SETUPS times in all, and the
    outcome says why."""
    again: tuple[str, ...] = ()
    while True:
        scene.refresh()
        if isinstance(fault, ArmFault):
            return _inject_arm(scene, fault, index)
        outcome = _inject_one(scene, fault, index, seed, seen_s)
        outcome.again = again
        if outcome.struck or outcome.skipped or len(again) == SETUPS - 1:
            return outcome
        again = (*again, "; ".join(outcome.wrong))


def _inject_arm(scene: Scene, fault: ArmFault, index: int) -> Outcome:
    """One of the arm's: its time is that to the last joint at rest."""
    outcome = Outcome(fault, index)
    begun_s = time.monotonic()
    try:
        rested = arm.strike(scene.arm, fault)
    except (TrialError, FailstopError, SimBoardError, OSError, subprocess.SubprocessError) as error:
        outcome.wrong.append(f"{type(error).__name__}: {error}")
        outcome.struck = False
    else:
        outcome.wrong += rested.wrong
        outcome.again = rested.again
        if rested.rest_ms is not None:
            rest_ns = round(rested.rest_ms * 1e6)
            outcome.stopped = Stopped(rested.fault_ns, rest_ns, None, None, rested.moves_after, True)
        outcome.events = list(rested.events)
    if outcome.wrong:
        outcome.said = scene.arm.service.said()
        scene.arm_spoiled = True
    outcome.took_s = time.monotonic() - begun_s
    return outcome


def _inject_one(scene: Scene, fault: Fault, index: int, seed: object, seen_s: float) -> Outcome:
    outcome = Outcome(fault, index, struck=False)
    # Of the row too: the same row at the same index is the same fault, whatever else a campaign draws.
    scene.chance = random.Random(f"{seed} {index} {fault.name}")
    if reason := injector(fault).unfit():
        outcome.skipped = reason
        return outcome
    begun_s = time.monotonic()
    injection = _Injection(scene, fault, outcome, seen_s)
    try:
        injection.run()
    except NotAtOnce as error:
        outcome.wrong.append(str(error))
        outcome.struck = False
    except (TrialError, FailstopError, SimBoardError, OSError, subprocess.SubprocessError) as error:
        outcome.wrong.append(f"{type(error).__name__}: {error}")
    if outcome.wrong:
        outcome.said = scene.service.said(injection.mark)
        scene.spoiled = True
    outcome.took_s = time.monotonic() - begun_s
    return outcome


def draw(rows: tuple[Row, ...], index: int, seed: int) -> Row:
    """The row of this index of a campaign."""
    return random.Random(f"{seed} {index}").choices(rows, [row.weight for row in rows])[0]


def campaign(
    scene: Scene, rows: tuple[Row, ...], seed: int, until: Callable[[int], bool], first: int = 0
) -> Iterator[Outcome]:
    """Random faults from index `first` on, until `until(injected)`. A row that can't be done here is yielded once,
    skipped."""
    rows = tuple(rows)
    unfit = {row.name: reason for row in rows if isinstance(row, Fault) and (reason := injector(row).unfit())}
    for row in rows:
        if row.name in unfit:
            yield Outcome(row, 0, skipped=unfit[row.name])
    index, injected = first, 0
    while len(unfit) < len(rows) and not until(injected):
        row = draw(rows, index, seed)
        if row.name not in unfit:
            yield inject_one(scene, row, index, seed)
            injected += 1
        index += 1
