"""Schedule: turns decisions into a run: which faults, where, and in which order threads run and stores are seen.

A run is a chain of scenarios, the rounds, on one service. In each, events come at calls of the system and at loads and
stores of shared memory, some few of them apart; after each the faults are off, and a program must be able to drive
again. An event is a draw whose label is its place: the round, the process, and which of its accesses to one place of
shared memory it is, or which call behind the last such store. So one that is left out moves few of the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any
from zlib import crc32

from failstop.messages import layout
from failstop_lab.machine.buffers import BEGIN_OF_FIRST, END_OF_FIRST, REST_OF_PLACE, WORD_BYTES
from failstop_lab.machine.epoll import Epoll
from failstop_lab.machine.memory import MET_NS, WeakMachine
from failstop_lab.machine.process import Process, Thread
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.decisions import Decisions
from failstop_lab.simulate.events import (
    BOARD_DEAF,
    DRAWN_EVENTS,
    EARLIER,
    GROUP_OF,
    GROUPS,
    HELD_FOR_NS,
    KEEPS,
    LATER,
    LIGHT,
    LOWERED,
    MEASURES,
    MEMORY,
    PAUSES,
    PULLED,
    RACES,
    REFUSES,
    SEEN_NS,
    SHORT_NS,
)
from failstop_lab.simulate.faults import faults, line_of
from failstop_lab.simulate.hot_records import RECORDS, HotRecords
from failstop_lab.simulate.stage import Stage
from failstop_lab.simulate.witness import PORT_WRITERS, SERVICE_PROCESSES, ZEROS_NS

WEIGHTS = {"port_owner": 1.0, "supervisor": 0.6, "stopper": 0.6, "gate": 0.5, "telemetry": 0.3}
"""How often an event that is due at a process comes; at any other one 0.2."""
ON = 0.6
"""How often a group of kinds is on in a run."""
GAPS = (15, 500)
"""Between these is a run's longest distance of two events, in calls; they are as often in each decade below it."""
AT_RARE = (0.02, 1.0)
"""Between these is how often one comes, in a run, at the first store of a place or at the call behind it; at the n-th
it is n times as seldom. What is stored often is met by the distances too."""
LOOKS, LATES = frozenset(EARLIER.values()), frozenset(LATER.values())
MEETS = LOOKS.union(RACES.values())
FARTHER, FARTHEST = 0.5, 4
"""How often an event that comes behind an access comes one call further away, and at most how many."""
HEAVY = 4
"""At most so many events of a round are more than a pause."""
ORDERS = 1 << 16


Act = Callable[[int], object]
Place = tuple[int, str, int | str]
"""A process's number, the name of a call or access, and where in shared memory it is, or the last store before it."""
Kinds = dict[str, Act]
"""The events that may happen at a place, by their kinds: called with its measure, one happens."""


@dataclass
class Event:
    """One that came."""

    label: str
    fault: str
    where: str


class Schedule:
    """The seam of a run. `groups`: the groups of events that may be on; empty: all. `records`: the numbers in RECORDS
    of the records that may be hot."""

    def __init__(
        self,
        stage: Stage,
        decisions: Decisions,
        groups: tuple[str, ...] = (),
        records: Collection[int] = range(len(RECORDS)),
    ) -> None:
        machine = stage.machine
        assert isinstance(machine, WeakMachine)
        self._stage, self._decisions, self._machine = stage, decisions, machine
        self._free = decisions.fixed is None
        dice = decisions.dice
        self._on = {group for group in groups or GROUPS if groups or dice.random() < ON}
        self._most_gap = GAPS[0] * (GAPS[1] / GAPS[0]) ** dice.random()
        self._at_rare = AT_RARE[0] * (AT_RARE[1] / AT_RARE[0]) ** dice.random()
        self._stored: dict[tuple[str, int], int] = {}
        """How often each process has stored at each place."""
        self._marked: Thread | None = None
        """At its next call or access an event comes."""
        self._far = 0
        """So many more calls lie between."""
        self._marked_for: Collection[str] = DRAWN_EVENTS
        """One of these."""
        self._hot = HotRecords(decisions.dice, machine, records)
        self.events: list[Event] = []
        self.calls = 0
        self._round = 0
        self._due = 0
        self._heavy = 0
        self._here: dict[str, int] = {}
        self._counts: dict[Place, int] = {}
        """How often each place was come to in the round."""
        self._behind: dict[int, str] = {}
        """By pid: its last store."""
        self._names: dict[int, str] = {}
        """By pid: `gate 2` is the second gate of the round. Given at its begin and at each start, so that they hang on
        nothing else that happens."""
        self._crc = 0
        heard = stage.robot.board.on_bytes

        def hears(data: bytes) -> None:
            self._crc = crc32(data, self._crc + machine.now_ns & 0xFFFFFFFF)
            heard(data)

        stage.robot.board.on_bytes = hears
        before = machine.on_event

        def on_event(kind: str, process: Process, what: object) -> None:
            if kind == "started":
                self._give_name(process)
            before(kind, process, what)

        machine.on_event = on_event
        if self._free:
            machine.on_late = self._mark

    def begin(self, number: int) -> None:
        """A round, of this number."""
        machine, decisions = self._machine, self._decisions
        for pid in [pid for pid, each in machine.processes.items() if each.dead and each.code is not None]:
            if machine.processes[pid].reaped or machine.processes[pid].parent is None:
                del machine.processes[pid]
        self._round, self._heavy, prefix = number, HEAVY, f"{number} "
        self._counts, self._names, self._behind = {}, {}, {}
        for process in machine.processes.values():
            if not process.dead:
                self._give_name(process)
        self._here = {}
        if decisions.fixed is not None:
            self._here = {
                each[len(prefix) :]: value for each, value in decisions.fixed.items() if each.startswith(prefix)
            }
        machine.order = decisions.draw(f"{prefix}order", ORDERS, 0.5 * ("order" in self._on or not self._free))
        self._stage.hang_up_ns = self._late_hang_up(f"{prefix}hang-up")
        self._due = self._gap()
        if self._free:
            self._hot.begin(memory=not self._on.isdisjoint(MEMORY), others=not self._on.issubset(MEMORY))
            self._due = 1 << 62 if self._hot.alone else self._due
        machine.at_seam = self._at

    def end(self) -> None:
        """Inject no more faults."""
        self._machine.at_seam = None
        self._machine.calm()

    def kind(self, event: Event) -> str:
        """The kind of the event, one of DRAWN_EVENTS."""
        return DRAWN_EVENTS[(self._decisions.drawn[event.label] - 1) // MEASURES]

    def digest(self) -> int:
        """A checksum of everything that was written to the board and when, and of the number of calls. Equal runs have
        equal ones."""
        return crc32(f"{self._machine.now_ns} {self.calls}".encode(), self._crc)

    def _gap(self) -> int:
        return int(self._most_gap ** self._decisions.dice.random()) if self._free else 1 << 62

    def _late_hang_up(self, label: str) -> Callable[[Epoll], int]:
        """How much later one process is woken by the loss of the port."""
        value = self._decisions.draw(label, 1 + len(PORT_WRITERS) * MEASURES, 0.3)
        if not value:
            return lambda epoll: 0
        name, ns = PORT_WRITERS[(value - 1) // MEASURES], 10 * SHORT_NS[(value - 1) % MEASURES]

        def late_ns(epoll: Epoll) -> int:
            process = self._stage.robot.named(name)
            return ns if process and any(each.node is epoll for each in process.files.values()) else 0

        return late_ns

    def _give_name(self, process: Process) -> None:
        same = sum(self._machine.processes[pid].name == process.name for pid in self._names)
        self._names[process.pid] = f"{process.name} {same + 1}"

    def _at(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        process = thread.process
        if self._stage.witness.violations:
            return  # an event from now on has no part in it
        pid = process.pid
        key = (pid, call, about[1]) if call in ("load", "store") else (pid, call, self._behind.get(pid, ""))
        number = self._counts[key] = self._counts.get(key, 0) + 1
        if call == "store":
            self._behind[pid] = f"{about[1]}:{number}"
        self.calls += 1
        if self._free:
            self._due -= 1
            at_word = call in ("load", "store")
            if (thread is self._marked and self._is_far()) or (
                call == "store" and not self._hot.alone and self._is_rare(thread, about[1])
            ):
                kinds, self._marked, self._marked_for = self._marked_for, None, DRAWN_EVENTS
                self._come(thread, call, about, key, kinds)
            elif at_word and self._hot.comes(call, about[0], about[1]):
                # Here, or at the call behind it, where a store may be late, or another load older than this one.
                if self._decisions.dice.random() < 0.5:
                    self._come(thread, call, about, key, LOOKS if call == "load" else MEETS)
                else:
                    self._marked, self._marked_for = thread, self._kinds_behind(thread, call)
                    self._far = 0
                    while self._far < FARTHEST and self._decisions.dice.random() < FARTHER:
                        self._far += 1
            elif self._due <= 0:
                self._due = self._gap()
                if self._decisions.dice.random() < WEIGHTS.get(process.name, 0.2):
                    self._come(thread, call, about, key)
        elif self._here:
            place = self._label(key)
            if value := self._here.get(place):
                kinds = dict(self._possible(thread, call, about))
                if act := kinds.get(DRAWN_EVENTS[(value - 1) // MEASURES]):
                    self._happen(f"{self._round} {place}", value, act, thread, call, about)

    def _label(self, place: Place) -> str:
        """Where the process is, the last time that it came to that place."""
        pid, call, at = place
        return f"{self._names[pid]} {call} {at} {self._counts[place]}"

    def _is_rare(self, thread: Thread, at: int) -> bool:
        """Whether an event comes at this store; at the call behind it one comes as often."""
        place, dice = (thread.process.name, at), self._decisions.dice
        count = self._stored[place] = self._stored.get(place, 0) + 1
        if self._hot.alone or dice.random() * count >= self._at_rare:
            return False
        if dice.random() < 0.5:
            return True
        self._marked, self._marked_for, self._far = thread, DRAWN_EVENTS, 0
        return False

    def _kinds_behind(self, thread: Thread, call: str) -> Collection[str]:
        """The kinds of events behind an access: behind a load a store that was made before it may be late as well."""
        is_late = call == "store" or (self._machine.view(thread).since and self._decisions.dice.random() < 0.5)
        return LATES if is_late else LOOKS

    def _is_far(self) -> bool:
        """Whether the marked thread has come to where its event is."""
        self._far -= 1
        return self._far < 0

    def _mark(self, thread: Thread) -> None:
        """It has seen that a store is late: what comes next is worth an event, as often as not of its own loads."""
        self._marked, self._far = thread, 0
        self._marked_for = LOOKS if self._decisions.dice.random() < 0.5 else DRAWN_EVENTS

    def _come(
        self, thread: Thread, call: str, about: tuple[Any, ...], place: Place, kinds: Collection[str] = DRAWN_EVENTS
    ) -> None:
        """An event of one of these kinds, if any is on that may happen here."""
        dice = self._decisions.dice
        groups = dict[str, Kinds]()
        for kind, act in self._possible(thread, call, about):
            group = GROUP_OF[kind]
            if kind in LOOKS and call != "load" and kinds is DRAWN_EVENTS:
                continue  # it comes where something is to be seen alone: a call says little of the loads behind it
            if group in self._on and kind in kinds and (self._heavy or group in LIGHT):
                groups.setdefault(group, {})[kind] = act
        if not groups:
            return
        group = dice.choice(list(groups))
        self._heavy -= group not in LIGHT
        kind = dice.choice(list(groups[group]))
        least = 0 if kinds is DRAWN_EVENTS else MEASURES // 2  # to be met there takes its time
        value = 1 + DRAWN_EVENTS.index(kind) * MEASURES + dice.randrange(least, MEASURES)
        self._happen(f"{self._round} {self._label(place)}", value, groups[group][kind], thread, call, about)

    def _happen(self, label: str, value: int, act: Act, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        self._decisions.put(label, value)
        where = f"{thread.process.name} {call}{self._record(call, about)} {line_of(call, about)}"
        self.events.append(Event(label, "", where))
        self._say(DRAWN_EVENTS[(value - 1) // MEASURES])
        act((value - 1) % MEASURES)

    def _say(self, text: str) -> None:
        """Name the newest event in the story."""
        event, story = self.events[-1], self._stage.witness.story
        if event.fault:
            story.pop()
        event.fault = text
        self._stage.witness.note(f"ODD: {text}, at {event.where}")

    def _record(self, call: str, about: tuple[Any, ...]) -> str:
        """The record that a load or a store is of."""
        if call not in ("load", "store"):
            return ""
        node, at, _ = about
        segment = self._hot.segments.name(node)
        spec = layout.SEGMENT_BY_NAME.get(segment)
        if spec is None:
            return " of a segment"
        return f" of {segment}.{max((begin, name) for name, begin in spec.offsets.items() if begin <= at)[1]}"

    def _possible(self, thread: Thread, call: str, about: tuple[Any, ...]) -> Iterator[tuple[str, Act]]:
        """The events that may happen at this call, by their kinds."""
        stage, machine, process = self._stage, self._machine, thread.process

        def pauses(measure: int, late: int = 0, early: int = 0) -> None:
            ns = (SEEN_NS if late or early else SHORT_NS)[measure]
            self._say(
                f"{PAUSES} for {ns / MS:g} ms" + (LATER.get(late) or EARLIER.get(early) or PAUSES).removeprefix(PAUSES)
            )
            stage.witness.late(process, ns)
            machine.pause(ns, late, early)

        yield PAUSES, pauses
        view = machine.view(thread)
        for late, kind in LATER.items():
            if view.may_be_late(late):
                yield kind, lambda measure, late=late: pauses(measure, late)  # type: ignore[misc]
        size = about[2] if call in ("load", "store") else 0
        for early, kind in EARLIER.items():
            if early not in (BEGIN_OF_FIRST, END_OF_FIRST, REST_OF_PLACE):
                yield kind, lambda measure, early=early: pauses(measure, 0, early)  # type: ignore[misc]
            elif size <= WORD_BYTES:
                continue
            elif call == "load":
                yield kind, lambda measure, early=early: pauses(measure, 0, early)  # type: ignore[misc]
            if call == "store" and early in RACES:
                yield RACES[early], lambda measure, early=early: self._race(thread, about[0], early, measure)  # type: ignore[misc]
        yield LOWERED, lambda measure: machine.lower(thread)
        names = [name for name, _ in faults(stage, thread, call, about)]
        for index, name in enumerate(names):
            yield name, lambda measure, index=index: self._fault(thread, call, about, index, measure)  # type: ignore[misc]
        port = stage.robot.board.port
        if process.name in SERVICE_PROCESSES and port and port.drains:
            yield REFUSES, lambda measure: self._refuse(SHORT_NS[measure])
            yield KEEPS, lambda measure: self._keep(HELD_FOR_NS[measure])
            yield BOARD_DEAF, lambda measure: self._deafen(HELD_FOR_NS[measure])
            yield PULLED, lambda measure: self._pull(HELD_FOR_NS[measure])

    def _race(self, thread: Thread, node: Any, early: int, measure: int) -> None:
        ns = SEEN_NS[measure]
        self._say(f"{RACES[early]}, for {ns / MS:g} ms at most")
        self._stage.witness.late(thread.process, ns + MET_NS)
        self._machine.race(ns, node, early)

    def _fault(self, thread: Thread, call: str, about: tuple[Any, ...], index: int, measure: int) -> None:
        name, inject = next(
            itertools.islice(faults(self._stage, thread, call, about, HELD_FOR_NS[measure]), index, None)
        )
        self._say(name)
        inject()

    # The port and the board.

    def _later(self, ns: int, what: Callable[[], None]) -> None:
        """In the same round."""
        number, machine = self._round, self._machine
        machine.at(machine.now_ns + ns, lambda: what() if self._round == number and machine.at_seam else None)

    def _refuse(self, ns: int) -> None:
        self._say(f"{REFUSES} for {ns / MS:g} ms")
        port = self._stage.robot.board.port
        assert port
        port.refuses = True
        self._later(ns, port.accept_again)

    def _keep(self, ns: int) -> None:
        self._say(f"{KEEPS} for {ns / MS:g} ms")
        port = self._stage.robot.board.port
        assert port
        self._stage.block_port()
        self._later(ns, lambda: None if port.gone else port.drain())

    def _deafen(self, ns: int) -> None:
        self._say(f"{BOARD_DEAF} for {ns / MS:g} ms")
        stage, board = self._stage, self._stage.robot.board

        def over() -> None:
            board.model.deaf = False
            stage.witness.hears_ns = stage.machine.now_ns + ZEROS_NS

        board.catch_up()
        stage.deafen()
        self._later(ns, over)

    def _pull(self, ns: int) -> None:
        self._say(f"{PULLED}, and is back under another number after {ns / MS:g} ms")
        stage = self._stage
        stage.unplug()
        self._later(ns, lambda: None if stage.robot.board.port else stage.replug())
