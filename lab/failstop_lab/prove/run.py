"""One stop path at one velocity: spin the wheels, bring the stop about, see them come to rest, judge it."""

from __future__ import annotations

import dataclasses
import random
import subprocess
import time
from typing import Any

from failstop.api.errors import FailstopError
from failstop.api.snapshot import State
from failstop.messages.layout import SUPERVISOR
from failstop.policy import causes
from failstop_lab.faults.fault import Wanted, fits, in_words
from failstop_lab.faults.steps import Steps
from failstop_lab.prove import held, shake, table
from failstop_lab.prove.sight import SeenSample, Sight
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.strike import Ask, Skipped, strike
from failstop_lab.prove.table import Path, Turning
from failstop_lab.prove.watch import Watch
from failstop_lab.trial import TrialError

NS = 1e9
STEADY_S = 0.8
"""At speed before the stop: a window of the judgement, and some."""
LEAST_S = 1.3
MOST_S = 3.5
"""After the cause. Wheels that still turn then are not left to turn on."""
STAYS_S = 0.4
"""Rest must last for so long after it was seen."""
BACK_S = 2.0
WHOLE_S = 10.0
SILENCE_CAUSES = (*held.BUSY, causes.HANGS, causes.MUTE, causes.DRIVER_SILENT, causes.OPERATOR_GONE)
"""Causes that a process has which was not run, whatever kept it: one of the service's, or this one, which drives and
attends."""


@dataclasses.dataclass
class Result:
    """The outcome of one run. Times count from the cause; None: it was not seen."""

    path: Path
    velocity: Turning
    simulated: bool
    written_ms: float | None = None
    written_by: str = ""
    acknowledged_ms: float | None = None
    rest_s: float | None = None
    bar_s: float | None = None
    """The bar of the time to rest, s, for what this robot can observe. None: the path's bar."""
    blind_s: float = 0.0
    """Nothing was reported for so long before the moment of rest, which is then the latest it can have been."""
    board_ms: float | None = None
    """When the simulated board itself got its first stop frame."""
    back_s: float | None = None
    """Scan: from the sensor's return to turning wheels."""
    latched: str | None = None
    skipped: str = ""
    runaway: bool = False
    """The wheels did not come to rest."""
    over: str = ""
    """Why no other run can follow; empty: one can."""
    wrong: list[str] = dataclasses.field(default_factory=list)
    """Faults."""
    doubts: list[str] = dataclasses.field(default_factory=list)
    """Those of them that a machine which runs nobody in time brings about too: times, and what a stop for it spoils."""
    starved: str = ""
    """The sign that the machine did not run everybody in time meanwhile; empty: there is none."""
    arm: dict[str, Any] | None = None
    """The joint that swung: its name and rate, its commanded position at the cause and its measured positions
    (pulses)."""
    samples: list[SeenSample] = dataclasses.field(default_factory=list)
    """Around the cause; the times count from it, ns."""
    again: list[str] = dataclasses.field(default_factory=list)
    """Signs for which it was taken again: the machine had spoiled it."""

    @property
    def rest_bar_s(self) -> float:
        """From the cause to rest, at most."""
        return self.path.rest_bar_s(self.velocity) if self.bar_s is None else self.bar_s

    @property
    def verdict(self) -> str:
        """PASS, FAIL, SKIP, or INVALID: what is wrong may be the machine's doing, and nothing is proved."""
        if self.skipped or not self.wrong:
            return "SKIP" if self.skipped else "PASS"
        doubtful = self.starved and not self.runaway and set(self.wrong) <= set(self.doubts)
        return "INVALID" if doubtful else "FAIL"

    def doubt(self, what: str) -> None:
        """Something is wrong that a starved machine may have brought about."""
        self.wrong.append(what)
        self.doubts.append(what)


class PathRun:
    """From enable to a whole service with nothing enabled."""

    def __init__(
        self,
        stand: ProveStand,
        sight: Sight,
        path: Path,
        velocity: Turning,
        ask: Ask | None,
        chance: random.Random,
    ) -> None:
        """`chance`: for what is left to it in a row of the fault table."""
        self.stand = stand
        self.sight = sight
        self.path = path
        self.velocity = velocity
        self.ask = ask
        self.result = Result(path, velocity, stand.board is not None, bar_s=sight.rest_bar_s(path, velocity))
        self._steps = Steps(path.fault, chance) if path.fault else None
        self._pids: dict[str, int] = {}
        self.cause_ns = 0
        """When the stop was brought about."""
        self._rest_seen_ns = 0
        self._verdict = sight.verdict()

    def perform(self) -> Result:
        """Do it. What can't be done, and what must not happen, is in the result."""
        result = self.result
        if self.path.kind == table.PAD_STOP and not self.ask and not self.stand.board:
            result.skipped = "nobody to press a button (--pad asks for it)"
            return result
        begun = self.stand.held.mark()
        self.stand.others.begin(self.path.latched)
        try:
            self._spin()
            if before := self.stand.driver.robot.state.cause:
                result.starved = self.stand.held.starved(begun, before)
                raise TrialError(f"a stop came before the test caused one: {before}")
            try:
                self._stop()
                if self.path.kind == table.SCAN and not result.runaway:
                    self._sense_again()
            except Skipped as reason:
                result.skipped = str(reason)
                self.stand.driver.robot.disable()
            if not result.runaway:
                self._recover()
        except (TrialError, FailstopError, OSError) as error:
            result.doubt(f"{type(error).__name__}: {error}")
            start_over(self.stand, self.sight, result)
        result.starved = result.starved or self.stand.held.starved(begun)
        return result

    def _stop(self) -> None:
        """Bring the stop about, see it through, judge it."""
        self.cause_ns = self._strike()
        self._verdict = self.sight.verdict(self.cause_ns)
        self.stand.run(MOST_S, self._settled)
        self.judge()

    def _strike(self) -> int:
        if self._steps:
            return self._steps.perform(self._pids, self.stand.run)
        return strike(self.path, self.stand, self.ask)

    def _spin(self) -> None:
        stand = self.stand
        stand.watch.forget()
        stand.driver.velocity = self.velocity.command
        stand.driver.enable()
        if stand.board:
            stand.board.events()
        stand.run(speed_up_s(stand, self.velocity) + STEADY_S)
        self._pids = stand.service.pids()

    def _settled(self) -> bool:
        """Everything was seen that is to be seen."""
        if self.path.ends:
            self._tap_port()
        now_ns = time.monotonic_ns()
        if not self._verdict.still(self.stand.watch.samples):
            self._rest_seen_ns = 0
            return False
        self._rest_seen_ns = self._rest_seen_ns or now_ns
        waited = now_ns > max(self.cause_ns + LEAST_S * NS, self._rest_seen_ns + STAYS_S * NS)
        return waited and (self._acknowledged() is not None or not self.stand.means.acknowledged_by)

    def _tap_port(self) -> None:
        """A service that has gone leaves the port to us."""
        if self.stand.service.gone():
            self.stand.watch.tap_port()

    def _after(self) -> list[SeenSample]:
        return [sample for sample in self.stand.watch.samples if sample[0] >= self.cause_ns]

    def _acknowledged(self) -> int | None:
        return acknowledged_ns(self.stand.watch, self.cause_ns, by_gate=self.path.by_gate)

    def judge(self) -> None:
        """Whether all was as it should be, by what was seen since the cause."""
        result, path = self.result, self.path
        before = self._before()
        judge_written(result, self.stand.watch, self.cause_ns, acknowledged=bool(self.stand.means.acknowledged_by))
        if self.sight.by:
            self._judge_rest(before)
        if self.stand.board:
            self._judge_board()
        if not path.ends and path.process != SUPERVISOR:
            self._judge_latch()

    def _before(self) -> list[SeenSample]:
        """The samples of half a second before the cause, in which the wheels turned; all are kept in the result."""
        samples = self.stand.watch.samples
        self.result.samples = [(t_ns - self.cause_ns, one, other) for t_ns, one, other in samples]
        before = [sample for sample in samples if -0.55 * NS < sample[0] - self.cause_ns < 0]
        if not self.sight.turning(before):
            self.result.doubt("the wheels were not seen turning before the stop")
        return before

    def _judge_rest(self, before: list[SeenSample]) -> None:
        result, sight = self.result, self.sight
        after = self._after()
        if not self._verdict.still(self.stand.watch.samples):
            seen = f"the {sight.source} is silent" if not after else "THE WHEELS DID NOT COME TO REST"
            result.wrong.append(seen)
            result.runaway = True
            return
        rest_ns = sight.rest_ns(before + after, self.velocity.name)
        if rest_ns is None:
            result.doubt(f"the samples of the {sight.source} show no moment of rest")
            return
        rest_ns = max(rest_ns, self.cause_ns)
        result.rest_s = (rest_ns - self.cause_ns) / NS
        result.blind_s = sight.blind_ns(before + after, self.cause_ns, rest_ns) / NS
        self._judge_bar()

    def _judge_bar(self) -> None:
        result = self.result
        if result.rest_s is not None and result.rest_s - result.blind_s > result.rest_bar_s:
            result.doubt(f"at rest after {result.rest_s:.2f} s, the bar is {result.rest_bar_s:.2f}")

    def _judge_board(self) -> None:
        assert self.stand.board is not None
        result = self.result
        after = [event for event in self.stand.board.events() if event.arrival_ns >= self.cause_ns]
        stop = next((event for event in after if event.is_stop), None)
        if stop is None:
            result.wrong.append("the board has seen NO STOP")
            return
        result.board_ms = (stop.arrival_ns - self.cause_ns) / 1e6
        # A simulated board without real-time priority is held up itself, its reports with it, on a busy machine.
        held_ns = shake.longest_silence_ns(self.stand.watch.samples, self.cause_ns, stop.arrival_ns)
        bar_ms = self.path.reaction_bar_ms(simulated=True) + held_ns / 1e6
        if result.board_ms > bar_ms:
            result.doubt(f"at the board after {result.board_ms:.1f} ms, the bar is {bar_ms:.0f}")
        if moving := [event.arrival_ns for event in after if event.is_motion and event.index > stop.index]:
            # A silent sensor latches nothing: until it counts, commands that paused may go on behind the stop for that.
            excused = self.path.kind == table.SCAN and moving[-1] - self.cause_ns < bar_ms * 1e6
            (result.doubt if excused else result.wrong.append)(f"{len(moving)} motion frames after the stop")

    def _judge_latch(self) -> None:
        """With whatever the commands went on meanwhile."""
        result, wanted = self.result, self.path.latched
        judge_latch(result, self.stand.driver.robot.state, wanted)

    def _sense_again(self) -> None:
        """The commands have gone on: the wheels turn again by themselves."""
        watch = self.stand.watch
        begun_ns = time.monotonic_ns()
        self.stand.driver.senses = True

        def turns() -> bool:
            recent = [sample for sample in watch.samples if sample[0] > time.monotonic_ns() - 0.55 * NS]
            return self.sight.turning(recent)

        if self.stand.run(BACK_S + speed_up_s(self.stand, self.velocity), turns):
            self.result.back_s = (time.monotonic_ns() - begun_ns) / NS
        else:
            self.result.doubt("the sensor is back, but the wheels do not turn again")

    def _recover(self) -> None:
        """To wheels at rest, nothing enabled, every process running."""
        stand, path = self.stand, self.path
        if path.ends or path.process == SUPERVISOR:
            self.check_end()
            stand.bury()
            stand.start()
            return
        if self._steps:
            self._steps.undo(self._pids)
        stand.driver.until("the service to be whole again", stand.whole, WHOLE_S)
        stand.driver.robot.disable()

    def check_end(self) -> None:
        """A service that was told to end has ended well."""
        if self.path.kind == table.END and self.stand.service.process:
            try:
                code = self.stand.service.process.wait(WHOLE_S)
            except subprocess.TimeoutExpired:
                self.result.wrong.append(f"the service did not end within {WHOLE_S:g} s")
                return
            if code:
                self.result.wrong.append(f"the service ended with exit code {code}")


def start_over(stand: ProveStand, sight: Sight | None, result: Result) -> None:
    """After what says nothing of the wheels: stop them by every means, look, and only then begin again. `sight`: None
    if they were not to turn."""
    stand.driver.commands = False
    if not (known := stand.safe()).safe:
        result.wrong.append(known.sentence())
    if sight:
        stand.watch.forget()
        verdict = sight.verdict(time.monotonic_ns())
        seen = stand.watch.tap_port() and stand.run(MOST_S, lambda: verdict.still(stand.watch.samples))
        if not seen:
            result.wrong.append("the wheels were not seen at rest after that")
            result.runaway = True
            return
    try:
        stand.start()
    except (TrialError, FailstopError, OSError) as error:
        result.over = f"the service could not be started again: {error}"


def speed_up_s(stand: ProveStand, velocity: Turning) -> float:
    """The ramp's time."""
    forward, _, turn = velocity.command
    settings = stand.settings
    return max(abs(forward) / settings["limits.acceleration_mps2"], abs(turn) / settings["limits.acceleration_radps2"])


def _written(watch: Watch, cause_ns: int, *, by_gate: bool) -> tuple[int, str] | None:
    found = [(t_ns, "gate") for t_ns in watch.zeros] if by_gate else watch.written
    return min((entry for entry in found if entry[0] >= cause_ns), default=None)


def acknowledged_ns(watch: Watch, cause_ns: int, *, by_gate: bool) -> int | None:
    """When the board answered what it was asked behind the stop; None: it did not yet."""
    written = _written(watch, cause_ns, by_gate=by_gate)
    return written and min((t_ns for asked_ns, t_ns in watch.answers if asked_ns >= written[0]), default=None)


def judge_latch(result: Result, state: State, wanted: tuple[Wanted, ...]) -> None:
    """The cause that is latched is one of those wanted; none is where none is wanted."""
    result.latched = state.estop
    if fits(state.cause, wanted) if wanted else state.cause is None:
        return
    wrong = f"latched: {state.estop}" + (f", not {in_words(wanted)}" if wanted else "")
    if state.cause and state.cause.kind in SILENCE_CAUSES:
        result.doubt(wrong)
        result.starved = str(state.cause) if state.cause.kind in held.BUSY else result.starved
    else:
        result.wrong.append(wrong)


def judge_written(result: Result, watch: Watch, cause_ns: int, *, acknowledged: bool = True) -> None:
    """The stop and its acknowledgement, where the board gives one."""
    path = result.path
    written = _written(watch, cause_ns, by_gate=path.by_gate)
    if written is None:
        result.wrong.append("NO STOP written")
        return
    result.written_ms, result.written_by = (written[0] - cause_ns) / 1e6, written[1]
    bar_ms = path.reaction_bar_ms(simulated=result.simulated)
    if result.written_ms > bar_ms:
        result.doubt(f"written after {result.written_ms:.1f} ms, the bar is {bar_ms:.0f}")
    answer_ns = acknowledged_ns(watch, cause_ns, by_gate=path.by_gate)
    if answer_ns is None and not acknowledged:
        return
    if answer_ns is None:
        result.wrong.append("not acknowledged by the board")
        return
    result.acknowledged_ms = (answer_ns - cause_ns) / 1e6
    if result.acknowledged_ms - result.written_ms > table.ACKNOWLEDGED_MS:
        result.doubt(f"acknowledged after {result.acknowledged_ms:.0f} ms")
