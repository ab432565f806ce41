"""Every single fault: a scenario is run, and at each call of the system the run is forked, once for each fault that may
happen there; the fork goes on with the fault and is judged.

A fork of this process is a copy of the whole simulated machine, so a run costs only what comes after its fault. Clock
readings get no fault, because nobody can see what happened at one before the next call. Calls that only their own
process can see (faults.INTERNAL) get only their own refusals, unless every call is tried.
"""

from __future__ import annotations

import gc
import json
import multiprocessing
import os
import signal
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from failstop.policy.layouts import BOARDS
from failstop_lab.machine.loading import Patches
from failstop_lab.machine.process import Thread
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.call_sites import BEFORE, CallSites
from failstop_lab.simulate.equivalents import IS_HELD, Equivalents
from failstop_lab.simulate.events import GROUP_OF
from failstop_lab.simulate.faults import INTERNAL, faults, line_of
from failstop_lab.simulate.for_seeds import play_of
from failstop_lab.simulate.scenarios import DRIVEN
from failstop_lab.simulate.stage import Continuation, Stage

RUN_S = 60
"""A run that takes a processor for longer has gone astray."""
ALONE = ("",)
"""Plan.branches of a scenario whose begin is another plan's."""
SHARES = 2
"""Into so many parts the calls of a scenario are divided: each part runs the scenario twice before its first fault."""
BRANCHED = 16
"""As many, of what many scenarios begin with."""


def of_board(kind: str) -> str:
    """The option that names a board, for a command that plays something again; empty for the first board."""
    return "" if kind == BOARDS[0] else f" --board {kind}"


@dataclass
class JudgedRun:
    """One judged run: what was wrong, what happened, and where the fault came, if there was one."""

    scenario: str
    fault: str = ""
    call: int = 0
    """The number of the call in the scenario."""
    where: str = ""
    """The process, the call's name and the line of code."""
    violations: list[str] = field(default_factory=list)
    causes: list[str] = field(default_factory=list)
    story: list[tuple[int, str]] = field(default_factory=list)
    marks: dict[str, int] = field(default_factory=dict)
    board: str = BOARDS[0]
    why_asked: bool = True
    """Somebody asked why a process that was held is silent."""
    branched: bool = True
    """It came to the end of what many scenarios begin with."""

    def text(self) -> str:
        """The run as people read it, in ms from its begin."""
        begin_ns = self.story[0][0] if self.story else 0
        again = f"failstop simulate{of_board(self.board)} --scenario {self.scenario}"
        again += f" --call {self.call} --fault '{self.fault}'"
        head = f"{self.scenario}: {self.fault} at call {self.call}: {self.where}" if self.fault else self.scenario
        wrong = (f"  {text}" for text in self.violations)
        steps = (f"{(t_ns - begin_ns) / MS:10.3f} ms  {text}" for t_ns, text in self.story)
        return "\n".join((head, *wrong, *steps, f"again: {again}"))


@dataclass
class Result:
    """The result of a campaign."""

    runs: int = 0
    equivalent: int = 0
    """Runs that were not played, since each is the same as one that was (equivalents.py)."""
    used_s: float = 0.0
    """How long a processor was used, s."""
    calls: int = 0
    wrong: list[JudgedRun] = field(default_factory=list)
    marks: Counter[str] = field(default_factory=Counter)

    def add(self, run: JudgedRun) -> None:
        """One more run."""
        self.runs += 1
        self.marks.update(run.marks)
        if run.violations:
            self.wrong.append(run)

    def merge(self, other: Result) -> None:
        """The result of another share."""
        self.runs += other.runs
        self.equivalent += other.equivalent
        self.used_s += other.used_s
        self.calls += other.calls
        self.wrong += other.wrong
        self.marks.update(other.marks)


@dataclass(frozen=True)
class Plan:
    """A scenario's calls, or one share of them. `most`: how many calls of one line of code in one process are tried; 0:
    all. `only`: one call, by its number, and one fault, without a fork. `patches`: changes of the code
    (controls.py). `fault`: the name of the only fault that is tried; empty: every one."""

    scenario: str
    share: tuple[int, int] = (0, 1)
    most: int = 0
    seed: int = 0
    only: tuple[int, str] | None = None
    patches: Patches = ()
    fault: str = ""
    own: bool = False
    """Only what happens to the process that makes the call."""
    first: bool = False
    """The campaign ends with the first run that is wrong."""
    branches: tuple[str, ...] = ()
    """The scenarios that begin alike and share this plan, the plan's own one first. A run that reaches the end of the
    common part is forked for each of them; a run that doesn't is the same in all. If the first name is empty, the plan
    has one scenario alone, from the end of the common part on."""
    board: str = BOARDS[0]
    """The kind of board, as in the setting board.kind."""


class Explorer:
    """Runs one Plan."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._seen: Counter[tuple[str, str]] = Counter()
        self._count = 0
        self._looks = 0
        self._branched = False
        self._runs: list[JudgedRun] = []
        """In a fork: those of the scenarios that it was forked for in turn."""
        self._to: int | None = None
        """In a fork: where its run is reported."""
        self.run = JudgedRun(plan.scenario, board=plan.board)
        self.result = Result()

    def explore(self) -> Result:
        """Every fault of the plan. The scenario is run once before, and what it has loaded is loaded before a fork."""
        plan = self._plan
        before = self._new_stage()
        sites = CallSites(before)
        before.run()
        self._before = sites.before
        self.stage = self._new_stage()
        for name in before.robot.loader.loaded():
            self.stage.robot.loader.load(name)
        before.machine.end()
        self._equivalents = Equivalents(self.stage)
        self.stage.branch = self._branch
        self.stage.machine.at_seam = self._only if plan.only else self._fork_here
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            self.stage.run()
            run = self._judged()
            if self._to is not None:
                _send(self._to, [*self._runs, run])
        except BaseException:
            if self._to is None:
                raise
            traceback.print_exc()
            os._exit(1)  # a fork must not go on as whoever started the campaign
        finally:
            gc.enable()
            gc.unfreeze()
        self.result.add(run)
        self.stage.machine.end()
        return self.result

    def _branch(self, rest: Continuation) -> Continuation:
        """The continuation that this process plays behind the begin which many scenarios share."""
        plan, self._branched = self._plan, True
        if plan.branches in ((), ALONE):
            return rest
        if self._to is None:
            self.stage.machine.at_seam = None  # each scenario's own plan goes on from here
            return rest
        for name in plan.branches[1:]:
            signal.setitimer(signal.ITIMER_PROF, RUN_S)
            reader, writer = os.pipe()
            child = os.fork()
            if not child:
                os.close(reader)
                signal.setitimer(signal.ITIMER_PROF, RUN_S)
                self._to, self._runs, self.run.scenario = writer, [], name
                return DRIVEN[name]
            os.close(writer)
            self._runs += _received(child, reader, replace(self.run, scenario=name))
        return rest

    def _new_stage(self) -> Stage:
        plan = self._plan
        return Stage(play_of(plan.scenario), plan.seed, plan.patches, kind=plan.board)

    def _judged(self) -> JudgedRun:
        run, witness = self.run, self.stage.witness
        run.violations, run.causes, run.story = witness.violations, witness.causes, witness.story
        run.marks = dict(self.stage.coverage.counts)
        run.branched = self._branched
        run.why_asked = self.stage.machine.starved_looks > self._looks
        return run

    def _fork_here(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        plan, self._count = self._plan, self._count + 1
        if not self.stage.explored or thread.process.name == "last.py":
            return
        where = f"{thread.process.name} {call} {line_of(call, about)}{BEFORE * (self._count in self._before)}"
        self._seen[thread.process.name, where] += 1
        if plan.most and self._seen[thread.process.name, where] > plan.most:
            return
        if plan.branches == ALONE and not self._branched:
            return
        if self._count % plan.share[1] != plan.share[0]:
            return
        self.result.calls += 1
        for fault, inject in faults(self.stage, thread, call, about):
            if self.stage.machine.at_seam is None:
                return
            group = GROUP_OF[fault]
            if plan.fault not in ("", fault) or (plan.own and group == "beside"):
                continue
            if plan.most and call in INTERNAL and group != "refused":
                continue
            if self._equivalents.tried(fault, thread):
                self.result.equivalent += 1
                continue
            reader, writer = os.pipe()
            child = os.fork()
            if not child:
                os.close(reader)
                signal.setitimer(signal.ITIMER_PROF, RUN_S)
                self._to = writer
                self._begin(fault, where)
                inject()
                return
            os.close(writer)
            try:
                self._collect(child, reader, JudgedRun(plan.scenario, fault, self._count, where, board=plan.board))
            except BaseException:  # Ctrl-C, a test's time limit: it passes through programs that make calls on its way
                self.stage.machine.at_seam = None
                raise

    def _only(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        self._count += 1
        assert self._plan.only
        if self._count == self._plan.only[0]:
            for fault, inject in faults(self.stage, thread, call, about):
                if fault == self._plan.only[1]:
                    self._begin(fault, f"{thread.process.name} {call} {line_of(call, about)}")
                    inject()

    def _begin(self, fault: str, where: str) -> None:
        self.stage.machine.at_seam = None
        self.run = JudgedRun(self._plan.scenario, fault, self._count, where, board=self._plan.board)
        self._looks = self.stage.machine.starved_looks
        self.stage.witness.note(f"FAULT: {fault}, at {where}")

    def _collect(self, child: int, reader: int, run: JudgedRun) -> None:
        runs = _received(child, reader, run)
        for each in runs:
            self.result.add(each)
        if not runs[-1].branched:
            self.result.equivalent += max(0, len(self._plan.branches) - 1)
        if runs[-1].fault == IS_HELD:
            self._equivalents.why_asked = any(run.why_asked for run in runs)
        if self._plan.first and any(run.violations for run in runs):
            self.stage.machine.at_seam = None


def _received(child: int, reader: int, run: JudgedRun) -> list[JudgedRun]:
    """The runs that a fork reports; where it has come to no end, this run, with the reason."""
    data = b""
    while piece := os.read(reader, 1 << 16):
        data += piece
    os.close(reader)
    _, status = os.waitpid(child, 0)
    if data:
        return [JudgedRun(**each) for each in json.loads(data)]
    return [replace(run, violations=[f"the simulation itself ended with {os.waitstatus_to_exitcode(status)}"])]


def _send(to: int, runs: list[JudgedRun]) -> None:
    """The end of a fork."""
    for run in runs:
        run.story = run.story if run.violations else []
    data = json.dumps([vars(run) for run in runs]).encode()
    while data:
        data = data[os.write(to, data) :]
    os._exit(0)


def explore(plan: Plan) -> Result:
    """The result of a plan, in this process."""
    begun = os.times()[:4]
    result = Explorer(plan).explore()
    result.used_s = sum(os.times()[:4]) - sum(begun)
    return result


def one(plan: Plan) -> JudgedRun:
    """The run of a plan with `only`."""
    explorer = Explorer(plan)
    explorer.explore()
    return explorer.run


def plans(names: Iterable[str], most: int, board: str = BOARDS[0], *, own: bool = False) -> list[Plan]:
    """Those of whole scenarios, in shares; what takes longest begins."""
    names = list(names)
    alike = tuple(name for name in names if name in DRIVEN)
    found: list[tuple[str, tuple[str, ...], int]] = [(alike[0], alike, BRANCHED)] if alike else []
    found += [(name, ALONE if name in alike else (), SHARES) for name in reversed(names)]
    return [
        Plan(name, (share, shares), most, board=board, branches=branches, own=own)
        for name, branches, shares in found
        for share in range(shares)
    ]


def results(todo: list[Plan], jobs: int) -> Iterator[tuple[Plan, Result]]:
    """Each plan with its result, as they come, in so many processes."""
    with multiprocessing.get_context("fork").Pool(jobs, maxtasksperchild=1) as pool:
        yield from pool.imap_unordered(_explored, todo)


def _explored(plan: Plan) -> tuple[Plan, Result]:
    return plan, explore(plan)
