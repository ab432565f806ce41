"""Seeds: runs in which a seed has drawn the scenario, the faults and the order; and what is left of a failure when
every event is taken out that it does not need.

The service is started once for each set of settings, and each run is a fork of that.
"""

from __future__ import annotations

import gc
import json
import multiprocessing
import os
import resource
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from failstop.lab.boards.traits import traits_of
from failstop.lab.machine.files import Node
from failstop.lab.machine.loading import Patches
from failstop.lab.machine.robot import MS
from failstop.lab.simulate.campaign import of_board
from failstop.lab.simulate.odd import Event, Odd
from failstop.lab.simulate.places import Places, Where
from failstop.lab.simulate.scenarios import SCENARIOS, scenarios_of
from failstop.lab.simulate.stage import FROM_THE_START, SETTINGS, Stage
from failstop.lab.simulate.tape import Tape
from failstop.policy.layouts import BOARDS

WARM_NS = 300 * MS
"""After so long, and once the board hears, the service is ready, and a scenario begins."""
RUN_S = 60
"""A run that takes longer in real time has gone astray."""
MOST_SHRUNK = 5
"""So many failures of a campaign are shrunk."""
COLD = 0.1
"""So many of the runs of a scenario whose faults may come before the service is ready begin with its start."""


@dataclass
class Seeded:
    """The judged run of a seed."""

    seed: int
    scenario: str = ""
    events: list[Event] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    story: list[tuple[int, str]] = field(default_factory=list)
    marks: dict[str, int] = field(default_factory=dict)
    again: str = ""
    """The command that runs it again, without the seed."""

    def text(self) -> str:
        """The run as people read it."""
        begin_ns = self.story[0][0] if self.story else 0
        lines = [f"seed {self.seed}: {self.scenario}"]
        lines += [f"  {text}" for text in self.violations]
        lines += [f"{number:>4}. {event.fault}, at {event.where}" for number, event in enumerate(self.events, 1)]
        lines += [f"{(t_ns - begin_ns) / MS:10.3f} ms  {text}" for t_ns, text in self.story]
        return "\n".join((*lines, f"again: {self.again} --seed {self.seed}"))


@dataclass
class Seeds:
    """The result of a campaign of seeds."""

    runs: int = 0
    events: int = 0
    took_s: float = 0.0
    """Of a processor."""
    wrong: list[Seeded] = field(default_factory=list)
    marks: Counter[str] = field(default_factory=Counter)

    def add(self, run: Seeded) -> None:
        """One more run."""
        self.runs += 1
        self.events += len(run.events)
        self.marks.update(run.marks)
        if run.violations:
            self.wrong.append(run)

    def merge(self, other: Seeds) -> None:
        """The result of another process."""
        self.runs += other.runs
        self.events += other.events
        self.took_s += other.took_s
        self.wrong += other.wrong
        self.marks.update(other.marks)


def used_s() -> float:
    """The processor's time of this process and of its children that have ended."""
    both = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(each.ru_utime + each.ru_stime for each in both)


class Nursery:
    """Runs seeds: of these scenarios, or of all that the board can have, with the code changed so."""

    def __init__(self, names: list[str] | None = None, patches: Patches = (), board: str = BOARDS[0]) -> None:
        """`board`: its kind, as the setting board.kind."""
        self._board, traits = board, traits_of(board)
        self._names = names or scenarios_of(traits)
        self._again = f"failstop simulate{of_board(board)}{' --scenario ' + ','.join(names) if names else ''}"
        self._patches, self._warm_ns = patches, WARM_NS + traits.deaf_ns
        self._stages: dict[str, tuple[Stage, int]] = {}
        self._places: dict[tuple[str, bool], Where] = {}

    def _warm(self, name: str) -> tuple[Stage, int]:
        """The stage on which the service with this scenario's settings runs, and how many files it had made by then."""
        key = json.dumps(SETTINGS.get(SCENARIOS[name], {}))
        if key not in self._stages:
            made = self._new_stage(name)
            made.begin(self._warm_ns)
            self._stages[key] = made, Node.count
            gc.collect()
        return self._stages[key]

    def _new_stage(self, name: str) -> Stage:
        return Stage(SCENARIOS[name], 0, self._patches, stores=True, kind=self._board)

    def _stage(self, name: str, *, cold: bool) -> Stage:
        """In a fork: where a scenario is to be run."""
        if cold:
            return self._new_stage(name)
        stage, Node.count = self._warm(name)
        stage.take(SCENARIOS[name])
        return stage

    def run(self, seed: int, fixed: list[Event] | None = None) -> Seeded:
        """One run, in a fork. `fixed`: with these events alone."""
        tape = Tape(seed)
        name = self._names[tape.draw("scenario", len(self._names))]
        cold = SCENARIOS[name] in FROM_THE_START and bool(tape.draw("start", 2, COLD))
        if not cold:
            self._warm(name)
        if (name, cold) not in self._places:
            where, loaded = _forked(lambda: self._found(name, cold=cold))
            self._places[name, cold] = where
            for module in () if cold else loaded:
                self._warm(name)[0].robot.loader.load(module)
        found = _forked(lambda: self._judged(name, tape, fixed, cold=cold))
        found["events"] = [Event(**event) for event in found["events"]]
        return Seeded(seed, name, again=self._again, **found)

    def _found(self, name: str, *, cold: bool) -> tuple[Where, list[str]]:
        stage = self._stage(name, cold=cold)
        found = Places(stage)
        stage.run()
        return found.where(), stage.robot.loader.loaded()

    def _judged(self, name: str, tape: Tape, fixed: list[Event] | None, *, cold: bool) -> dict[str, Any]:
        stage = self._stage(name, cold=cold)
        odd = Odd(stage, tape, self._places[name, cold], fixed)
        stage.hang_up_ns = odd.late_hang_up_ns()
        stage.run()
        witness = stage.witness
        return {
            "events": [asdict(event) for event in odd.events],
            "violations": witness.violations,
            "story": witness.story if witness.violations else [],
            "marks": stage.marks.counts,
        }

    def shrunk(self, run: Seeded) -> Seeded:
        """The failure with as few events as it needs."""
        for label in [event.label for event in run.events]:
            fewer = [event for event in run.events if event.label != label]
            again = self.run(run.seed, fewer)
            if again.violations:
                run = again
        return run


def seeds(
    first: int,
    step: int,
    seconds: float,
    patches: Patches = (),
    names: list[str] | None = None,
    board: str = BOARDS[0],
) -> Seeds:
    """Run seeds: first, first + step, ... until so much of a processor's time is used."""
    nursery, found, seed, begun_s = Nursery(names, patches, board), Seeds(), first, used_s()
    while (took_s := used_s() - begun_s) < seconds:
        run = nursery.run(seed)
        found.add(run)
        if run.violations and len(found.wrong) <= MOST_SHRUNK:
            found.wrong[-1] = nursery.shrunk(run)
            if patches:
                break
        seed += step
    found.took_s = took_s
    return found


def many(
    first: int, seconds: float, jobs: int, names: list[str] | None = None, board: str = BOARDS[0]
) -> Iterator[Seeds]:
    """As seeds(), in so many processes."""
    todo = [(first + job, jobs, seconds, names, board) for job in range(jobs)]
    with multiprocessing.get_context("fork").Pool(jobs, maxtasksperchild=1) as pool:
        yield from pool.imap_unordered(_all, todo)


def _all(arguments: tuple[int, int, float, list[str] | None, str]) -> Seeds:
    first, step, seconds, names, board = arguments
    return seeds(first, step, seconds, names=names, board=board)


def _forked(what: Callable[[], Any]) -> Any:
    """The findings of a fork of this process."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        gc.disable()
        os.close(reader)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(RUN_S)
        try:
            data = json.dumps(what()).encode()
            while data:
                data = data[os.write(writer, data) :]
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(writer)
    data = b""
    while piece := os.read(reader, 1 << 16):
        data += piece
    os.close(reader)
    _, status = os.waitpid(child, 0)
    if not data:
        text = f"the simulation itself ended with {os.waitstatus_to_exitcode(status)}"
        return {"events": [], "violations": [text], "story": [], "marks": {}}
    return json.loads(data)
