"""Odd: what a seed makes of a run: which faults, where, and in which order threads and processes run.

A thread that pauses at a call lets everybody else run before it, which is how two processes come into another order.
The first event comes at a line of code of the unfaulted run, each further one so many calls or so much time after the
one before: far events hardly ever meet, and near ones are what single faults cannot try.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from random import Random
from typing import Any

from failstop.lab.machine.epoll import Epoll
from failstop.lab.machine.port import Port
from failstop.lab.machine.process import Process, Thread
from failstop.lab.machine.robot import MS
from failstop.lab.simulate.faults import Fault, faults, line_of
from failstop.lab.simulate.places import Where
from failstop.lab.simulate.stage import Stage
from failstop.lab.simulate.tape import Tape
from failstop.lab.simulate.witness import PORT_WRITERS, SERVICE_PROCESSES

OFTEN = (1.0, 1.0, 0.6, 0.4, 0.2)
"""How often there is a first event, a second, ... One alone is what the single faults are for."""
WEIGHTS = {"port_owner": 8, "supervisor": 4, "gate": 3, "stopper": 2, "player.py": 2, "telemetry": 1}
"""How often the first event is at a call of each."""
ODD_EVENTS = ("pauses", "held", "starved", "dies", "beside", "asked", "blocked", "sleeps", "refused")
ON = 0.6
"""How often a kind is on in a run."""
BEHIND = 3_000
"""At most so many calls after the event before."""
LATER_NS = 400 * MS
NEAR_CHANCE = 0.6
"""How often the next event is counted in calls, not in time."""

HANG_UP = "hang-up"


@dataclass
class Event:
    """One that came. `process` and `number`: its place, by the calls of that process."""

    label: str
    process: str
    number: int
    fault: str
    where: str = ""


def spread(dice: Random, least: float, most: float) -> int:
    """A number between the two, as often in each decade."""
    return round(least * float((most / least) ** dice.random()))


class Count:
    """Tells the processes of a machine apart by name and order, and counts the calls of each and of all."""

    def __init__(self) -> None:
        self.all = 0
        self._names: dict[int, str] = {}
        self._calls: dict[int, int] = {}
        self._starts: dict[str, int] = {}

    def one_more(self, process: Process) -> int:
        """Of this process: the number of this call of it."""
        self.all += 1
        number = self._calls[process.pid] = self._calls.get(process.pid, 0) + 1
        return number

    def name(self, process: Process) -> str:
        """`gate 2` is the second gate of the run, of those that have made a call at an event."""
        if process.pid not in self._names:
            before = [each for each in process.machine.processes.values() if each.name == process.name]
            self._names[process.pid] = f"{process.name} {before.index(process) + 1}"
        return self._names[process.pid]


class Odd:
    """The seam of one run. `fixed`: the events that come, where they came before; None: those of the tape."""

    def __init__(self, stage: Stage, tape: Tape, where: Where, fixed: Iterable[Event] | None = None) -> None:
        self._stage, self._tape = stage, tape
        self._count = Count()
        self._fixed = {(event.process, event.number): event for event in fixed or ()}
        self._free = fixed is None
        self._hangs = any(event.label == HANG_UP for event in fixed or ())
        self._on = [kind for kind in ODD_EVENTS if tape.dice(f"kind {kind}").random() < ON]
        self.events: list[Event] = []
        self._next = 0
        self._due, self._due_ns, self._who = 0, 0, ""
        if self._free:
            self._arm(where)
        stage.machine.at_seam = self._at

    def late_hang_up_ns(self) -> Callable[[Epoll], int]:
        """How much later each process is woken by the loss of the port."""
        if not self._free and not self._hangs:
            return lambda epoll: 0
        late = self._tape.draw(HANG_UP, 1 + len(PORT_WRITERS), 0.5)
        dice = self._tape.dice(f"{HANG_UP} by")
        ns = spread(dice, 100_000, 100 * MS)
        name = PORT_WRITERS[late - 1] if late else ""

        def of(epoll: Epoll) -> int:
            process = self._stage.robot.named(name) if name else None
            return ns if process and any(each.node is epoll for each in process.files.values()) else 0

        if late:
            self._tell(Event(HANG_UP, name, 0, f"{ns / MS:g} ms late", f"{name} hears of the loss of the port"))
        return of

    def _arm(self, where: Where | None = None) -> None:
        """Draw where the next event comes."""
        self._due = 1 << 62
        if self._next >= len(OFTEN):
            return
        label = f"event {self._next + 1}"
        self._next += 1
        if not self._tape.draw(label, 1 << 30, OFTEN[self._next - 1]):
            return
        dice = self._tape.dice(f"{label} at")
        self._label, self._who, self._due_ns = label, "", 0
        if where is not None:
            self._due = chosen(where, dice)
        elif dice.random() < NEAR_CHANCE:
            self._due = self._count.all + spread(dice, 1, BEHIND)
        else:
            self._due = 0
            self._due_ns = self._stage.machine.now_ns + spread(dice, 10_000, LATER_NS)
            self._who = dice.choice(("", *SERVICE_PROCESSES))

    def _at(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        process = thread.process
        number = self._count.one_more(process)
        if self._free:
            if self._count.all >= self._due and self._stage.machine.now_ns >= self._due_ns:
                self._come(thread, call, about, number)
        elif self._fixed and (event := self._fixed.get((self._count.name(process), number))):
            possible = self._possible(thread, call, about, self._tape.dice(f"{event.label} is"))
            for _, (fault, inject) in possible:
                if fault == event.fault:
                    self._tell(event)
                    inject()
                    return

    def _come(self, thread: Thread, call: str, about: tuple[Any, ...], number: int) -> None:
        """The next event comes at this call, where a fault that is on may happen at it."""
        process, label = thread.process, self._label
        if self._who and self._who != process.name:
            return
        dice, kinds = self._tape.dice(f"{label} is"), dict[str, list[Fault]]()
        for kind, possible in self._possible(thread, call, about, dice):
            if kind in self._on:
                kinds.setdefault(kind, []).append(possible)
        if not kinds:
            return
        fault, inject = dice.choice(kinds[dice.choice(sorted(kinds))])
        where = f"{process.name} {call} {line_of(call, about)}"
        self._tell(Event(label, self._count.name(process), number, fault, where))
        self._arm()
        inject()

    def _tell(self, event: Event) -> None:
        self._stage.witness.tell(f"ODD: {event.fault}, at {event.where}")
        self.events.append(event)

    def _possible(self, thread: Thread, call: str, about: tuple[Any, ...], dice: Random) -> Iterator[tuple[str, Fault]]:
        """Kind and fault of each that may happen at this call."""
        stage, process = self._stage, thread.process
        long_ns, short_ns = spread(dice, 20 * MS, 1_500 * MS), spread(dice, 1_000, 50 * MS)
        yield "pauses", (f"a thread pauses for {short_ns / MS:g} ms", lambda: _pause(stage, process, short_ns))
        for name, inject in faults(stage, thread, call, about, long_ns):
            yield _kind(name), (name, inject)
        if process.name not in SERVICE_PROCESSES:
            return
        port = stage.robot.board.port
        if port and port.drains:
            yield "blocked", (f"the port refuses for {short_ns / MS:g} ms", lambda: refuse(stage, port, short_ns))


def _kind(name: str) -> str:
    if name.startswith("somebody"):
        return "asked"
    if name.startswith("dies"):
        return "dies"
    if name.startswith(("held", "starved")):
        return name.split()[0]
    return "beside" if " beside" in name else "sleeps" if name == "machine sleeps" else "refused"


def _pause(stage: Stage, process: Process, ns: int) -> None:
    """The thread that runs does not go on for so long; the other threads of its process do."""
    stage.witness.late(process, ns)
    until_ns = stage.machine.now_ns + ns
    while stage.machine.now_ns < until_ns:
        stage.machine.block(until_ns)


def refuse(stage: Stage, port: Port, ns: int) -> None:
    """The port takes nothing for so long."""
    port.refuses = True
    stage.machine.at(stage.machine.now_ns + ns, port.take_again)


def chosen(where: Where, dice: Random) -> int:
    """The number of a call: most are of the port owner, since whatever is right or wrong happens there."""
    name = dice.choices(tuple(WEIGHTS), tuple(WEIGHTS.values()))[0]
    lines = [line for line in sorted(where) if line.startswith(f"{name} ")] or sorted(where)
    return dice.choice(where[dice.choice(lines)])
