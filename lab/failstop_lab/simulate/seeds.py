"""Seeds: long runs in which a seed has drawn scenarios, faults and order; and what is left of a failure when every draw
is taken out that it does not need.

The service is started once for each set of settings. Each run is a fork of that, and many scenarios long: a fork and
its end take as long as two of them.
"""

from __future__ import annotations

import functools
import gc
import json
import multiprocessing
import os
import resource
import signal
import subprocess
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from failstop.policy.layouts import BOARDS
from failstop.version import VERSION
from failstop_lab.boards.traits import traits_of
from failstop_lab.machine.files import Node
from failstop_lab.machine.loading import HOME, Patches
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.decisions import Decisions, Draws, shrunk
from failstop_lab.simulate.events import GROUP_OF
from failstop_lab.simulate.for_seeds import for_seeds_of, play_of
from failstop_lab.simulate.hot_records import RECORDS, StoredRecords
from failstop_lab.simulate.scenarios import scenarios_of
from failstop_lab.simulate.schedule import Event, Schedule
from failstop_lab.simulate.single_faults import of_board
from failstop_lab.simulate.stage import FROM_THE_START, SETTINGS, Stage

WARM_NS = 300 * MS
"""After so long, and once the board hears, the service is ready, and a scenario begins."""
SIMPLEST = "drive"
"""The scenario that a draw of 0 is."""
SPECIAL = 0.2
"""So many runs are of scenarios that need settings of their own."""
OTHERS = 0.5
"""So many of the rounds are another one."""
ROUNDS = 12
"""So many scenarios a run."""
EVERY_TWICE = 100
"""Every so many runs, one is made twice, the second time from its decisions."""
RUN_S = 60
"""A run that takes a processor for longer has gone astray."""
EVENT_WORDS = 2
SUFFIXES = (1, 2, 4, 8, 16, 32)
"""When a failure is shrunk, first only its last 1, 2, 4 ... events are kept, because most failures need no others. Only
then are parts left out."""
MOST_SHRUNK = 5
"""So many failures of a campaign are shrunk."""
COLD = 0.1
"""So many of the runs of a scenario whose faults may come before the service is ready begin with its start."""


@dataclass
class Seeded:
    """The judged run of a seed, or of given decisions."""

    seed: int
    rounds: list[str] = field(default_factory=list)
    """The scenarios that it has come to, each with its number."""
    events: list[Event] = field(default_factory=list)
    draws: Draws = field(default_factory=dict)
    violations: list[str] = field(default_factory=list)
    story: list[tuple[int, str]] = field(default_factory=list)
    marks: dict[str, int] = field(default_factory=dict)
    digest: int = 0
    """A checksum of everything that was written to the board."""
    groups: dict[str, int] = field(default_factory=dict)
    """How many events of each group came."""
    options: str = ""
    """Those of the command that runs it again."""

    def decisions(self) -> str:
        """The decisions, as they are printed and played again."""
        return json.dumps({"commit": commit(), "draws": self.draws}, separators=(",", ":"))

    def text(self) -> str:
        """The run as people read it."""
        begin_ns = self.story[0][0] if self.story else 0
        lines = [f"seed {self.seed}: {', '.join(self.rounds[-1:])}"]
        lines += [f"  {text}" for text in self.violations]
        lines += [f"{number:>4}. {event.fault}, at {event.where}" for number, event in enumerate(self.events, 1)]
        lines += [f"{(t_ns - begin_ns) / MS:10.3f} ms  {text}" for t_ns, text in self.story]
        return "\n".join((*lines, f"again: failstop simulate{self.options} --decisions '{self.decisions()}'"))


@functools.cache
def commit() -> str:
    """The commit of this checkout, or the version of what is installed."""
    told = subprocess.run(
        ("git", "-C", HOME, "rev-parse", "--short", "HEAD"), capture_output=True, text=True, check=False
    )
    return told.stdout.strip() if told.returncode == 0 else VERSION


@dataclass
class Seeds:
    """The result of a campaign of seeds."""

    runs: int = 0
    events: int = 0
    took_s: float = 0.0
    """How long a processor was used, s."""
    rounds: int = 0
    twice: int = 0
    """How many runs were made twice and were equal to the byte."""
    found_s: float = 0.0
    """How long a processor was used until the first wrong run, s."""
    wrong: list[Seeded] = field(default_factory=list)
    marks: Counter[str] = field(default_factory=Counter)
    groups: Counter[str] = field(default_factory=Counter)

    def add(self, run: Seeded) -> None:
        """One more run."""
        self.runs += 1
        self.rounds += len(run.rounds)
        self.events += sum(run.groups.values())
        self.marks.update(run.marks)
        self.groups.update(run.groups)
        if run.violations:
            self.wrong.append(run)

    def merge(self, other: Seeds) -> None:
        """The result of another process."""
        self.runs += other.runs
        self.events += other.events
        self.rounds += other.rounds
        self.twice += other.twice
        self.took_s += other.took_s
        self.groups.update(other.groups)
        self.wrong += other.wrong
        self.marks.update(other.marks)


def used_s() -> float:
    """The processor's time of this process and of its children that have ended."""
    both = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(each.ru_utime + each.ru_stime for each in both)


class Nursery:
    """Runs seeds: of these scenarios, or of all that the board can have, with the code changed so."""

    def __init__(
        self,
        names: list[str] | None = None,
        patches: Patches = (),
        board: str = BOARDS[0],
        groups: tuple[str, ...] = (),
        rounds: int = ROUNDS,
    ) -> None:
        """`board`: its kind, as the setting board.kind. `groups`: those of schedule.py that are on; empty: by each
        seed's own draw. `rounds`: so many scenarios a run."""
        self._board, traits = board, traits_of(board)
        self._names = names or [name for name in (*scenarios_of(traits), *for_seeds_of(traits)) if not stays_down(name)]
        self._alike: dict[str, list[str]] = {}
        """Scenarios by their settings, the simplest first: one run is of one kind."""
        for name in sorted(self._names, key=lambda name: name != SIMPLEST):
            self._alike.setdefault(json.dumps(SETTINGS.get(play_of(name), {})), []).append(name)
        self._options = of_board(board) + (f" --scenario {','.join(names)}" if names else "")
        self._patches, self._warm_ns = patches, WARM_NS + traits.deaf_ns
        self._groups, self._rounds = groups, rounds
        self._stages: dict[str, tuple[Stage, int]] = {}
        self._records: dict[str, list[int]] = {}
        """The numbers of the records that its scenarios store (hot_records.py), by their settings."""

    def _warm(self, key: str) -> tuple[Stage, int]:
        """The stage on which the service with these settings runs, and how many files it had made by then."""
        if key not in self._stages:
            made = self._new_stage(self._alike[key][0])
            made.begin(self._warm_ns)
            self._stages[key] = made, Node.count
            gc.collect()
        return self._stages[key]

    def _new_stage(self, name: str) -> Stage:
        return Stage(play_of(name), 0, self._patches, weak=True, kind=self._board)

    def run(self, seed: int, fixed: Draws | None = None) -> Seeded:
        """One run, in a fork. `fixed`: with these draws alone."""
        decisions = Decisions(seed, fixed)
        key = list(self._alike)[decisions.draw("settings", len(self._alike), SPECIAL)]
        names = self._alike[key]
        cold = play_of(names[0]) in FROM_THE_START and bool(decisions.draw("start", 2, COLD))
        if not cold:
            stage, _ = self._warm(key)
            if key not in self._records:
                needed = _forked(lambda: self._needed(key))
                self._records[key] = needed["records"]
                for module in needed["modules"]:
                    stage.robot.loader.load(module)
        found = _forked(lambda: self._judged(key, decisions, cold=cold))
        found["events"] = [Event(*event) for event in found["events"]]
        return Seeded(seed, options=self._options, **found)

    def _stage(self, key: str, *, cold: bool) -> Stage:
        """In a fork: where a run begins."""
        if cold:
            return self._new_stage(self._alike[key][0])
        stage, Node.count = self._warm(key)
        return stage

    def _needed(self, key: str) -> dict[str, Any]:
        """The modules that its scenarios load, and the records that they store."""
        stage = self._stage(key, cold=False)
        machine = stage.machine
        assert isinstance(machine, WeakMachine)
        stored = StoredRecords(machine)
        for name in self._alike[key]:
            stage.load(play_of(name))
            stage.play(must_end=False)
        stage.prove_alive()
        return {"modules": stage.robot.loader.loaded(), "records": sorted(stored.records)}

    def _judged(self, key: str, decisions: Decisions, *, cold: bool) -> dict[str, Any]:
        stage, names = self._stage(key, cold=cold), self._alike[key]
        schedule = Schedule(stage, decisions, self._groups, self._records.get(key) or range(len(RECORDS)))
        witness, rounds = stage.witness, list[str]()
        for number in range(1 + decisions.draw("skipped", self._rounds, 0.0), 1 + self._rounds):
            name = names[decisions.draw(f"{number} scenario", len(names), OTHERS)]
            rounds.append(f"{number} {name}")
            witness.note(f"round {number}: {name}")
            stage.load(play_of(name))
            schedule.begin(number)
            stage.play(must_end=False)
            schedule.end()
            stage.prove_alive()
            if witness.violations:
                break
        if stage.traits.watchdog_ns and not witness.violations:
            stage.prove_watchdog()
        return {
            "rounds": rounds,
            "events": [(each.label, each.fault, each.where) for each in schedule.events] if witness.violations else [],
            "draws": decisions.drawn,
            "violations": witness.violations,
            "story": witness.story if witness.violations else [],
            "marks": stage.coverage.counts,
            "digest": schedule.digest(),
            "groups": Counter(GROUP_OF[schedule.kind(each)] for each in schedule.events),
        }

    def shrunk(self, run: Seeded) -> Seeded:
        """The failure with as few draws as it needs."""
        best = run

        def fails(draws: Draws) -> Draws | None:
            nonlocal best
            again = self.run(run.seed, draws)
            if again.violations:
                best = again
                return again.draws
            return None

        if not run.rounds:
            return run  # it went astray, so it says of no round what it was
        number = int(run.rounds[-1].split()[0])
        for skipped in (number - 1, number - 2):
            kept = {label: value for label, value in run.draws.items() if not _before(label, skipped)}
            if skipped > 0 and (fails({**kept, "skipped": skipped}) or fails(kept)) is not None:
                break
        for each in range(1, number):
            prefix = f"{each} "
            if any(_is_event(label) and label.startswith(prefix) for label in best.draws):
                fails(
                    {key: value for key, value in best.draws.items() if not (_is_event(key) and key.startswith(prefix))}
                )
        for most in SUFFIXES:
            last = set([label for label in best.draws if _is_event(label)][-most:])
            kept = {label: value for label, value in best.draws.items() if label in last or not _is_event(label)}
            if fails(kept) is not None:
                break
        shrunk(best.draws, fails)
        return best


def stays_down(name: str) -> bool:
    """Whether a process may be down until a reset, or for a minute if it is the gate, which passes resets on."""
    return "restart.deaths" in SETTINGS.get(play_of(name), {})


def _is_event(label: str) -> bool:
    """Whether a draw is of a place, and so comes at its time: with the round, process, which of that name, and call."""
    return len(label.split()) > EVENT_WORDS


def _before(label: str, number: int) -> bool:
    """Whether a draw is of a round up to that number."""
    first = label.split()[0]
    return first.isdecimal() and int(first) <= number


def seeds(
    first: int,
    step: int,
    seconds: float,
    patches: Patches = (),
    names: list[str] | None = None,
    board: str = BOARDS[0],
    groups: tuple[str, ...] = (),
    rounds: int = ROUNDS,
) -> Seeds:
    """Run seeds: first, first + step, ... until so much of a processor's time is used."""
    nursery, found, seed = Nursery(names, patches, board, groups, rounds), Seeds(), first
    begun_s = used_s()
    while (took_s := used_s() - begun_s) < seconds:
        run = nursery.run(seed)
        if found.runs % EVERY_TWICE == 0 and not run.violations:
            found.twice += 1
            if nursery.run(seed, run.draws).digest != run.digest:
                run.violations.append("the same decisions made another run")
        found.add(run)
        if run.violations and len(found.wrong) <= MOST_SHRUNK:
            found.found_s = found.found_s or used_s() - begun_s
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
        signal.setitimer(signal.ITIMER_PROF, RUN_S)
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
        return {"events": [], "violations": [text]}
    return json.loads(data)
