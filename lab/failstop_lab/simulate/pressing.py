"""Pressing: a few records of shared memory in each round at which events of memory come far more often than elsewhere.

Two accesses whose order matters are met by chance once in some thousand rounds. Each round draws some of all records
that a process acts on, and those that order.py judges more often.
"""

from __future__ import annotations

from collections.abc import Collection
from random import Random
from typing import Any

from failstop.messages import layout
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.process import Thread
from failstop_lab.simulate.order import NAMED, shared_path

MOST_RECORDS = 8
"""At most so many in a round, and one at least."""
OFTEN = (0.3, 0.95)
"""Between these is how often an event comes at a store, or at a load, of one of them."""
SELDOMER, SELDOM = 0.5, 0.5
"""After each event at a record the next one there is so much less often, but never below that for all of them together:
some are accessed at every turn."""
ALONE, MEMORY_ALONE = 0.6, 0.9
"""In so many rounds nothing else comes: what needs a certain moment is not moved by other events. The second where
memory alone is odd."""
READ_BY_NO_PROCESS = ("everyone", "clients", "its successor, clients")
"""Readers of records that decide nothing (messages/layout.py), but for the beats."""
BEAT = "beat_ns"


def _begin(segment: str, name: str) -> int:
    return layout.SEGMENT_BY_NAME[segment].offsets[name]


def _places() -> list[tuple[str, range]]:
    """Records that other processes act on, each by its segment and its place; numbered ones are one place."""
    found: dict[tuple[str, str], range] = {}
    for spec in layout.SEGMENTS:
        for name, record in spec.records.items() if spec.mode == layout.PUBLIC else ():
            if record.readers not in READ_BY_NO_PROCESS or name == BEAT:
                begin, key = spec.offsets[name], (spec.name, name.rstrip("0123456789"))
                found[key] = range(found.get(key, range(begin, begin)).start, begin + record.size())
    return [(segment, place) for (segment, _), place in found.items()]


PLACES = _places()
JUDGED = {
    number
    for number, (segment, place) in enumerate(PLACES)
    if any(each[0] == segment and _begin(*each) in place for each in (name.split(".", 1) for name in NAMED))
}
"""Those whose order order.py judges."""
JUDGED_TOO = 2
"""So many times more than others they are drawn."""


class Segments:
    """The names of a machine's segments, by their files."""

    def __init__(self, machine: WeakMachine) -> None:
        self._machine = machine
        self._names: dict[int, str] = {}
        """By a file's number."""

    def name(self, node: Any) -> str:
        """Empty: the file is none."""
        if node.number not in self._names:
            self._names[node.number] = shared_path(self._machine, node).rpartition(".")[2]
        return self._names[node.number]

    def places(self, node: Any, at: int) -> list[int]:
        """An access by its number in PLACES: one or none."""
        segment = self.name(node)
        return [number for number, (name, place) in enumerate(PLACES) if name == segment and at in place]


class Met:
    """The records that are stored in a run that nothing happens in: others are nothing to press on."""

    def __init__(self, machine: WeakMachine) -> None:
        self._segments = Segments(machine)
        self.places: set[int] = set()
        machine.at_seam = self._at

    def _at(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        if call == "store":
            self.places.update(self._segments.places(about[0], about[1]))


class Pressing:
    """The records that the rounds of a run press on, out of these."""

    def __init__(self, dice: Random, machine: WeakMachine, places: Collection[int]) -> None:
        self._dice, self.segments = dice, Segments(machine)
        here = sorted(places)
        self._places = [PLACES[number] for number in (*here, *(JUDGED_TOO * [each for each in here if each in JUDGED]))]
        self._here: list[list[Any]] = []
        """The segment, the place in it, and how often an event comes there now, by the access."""
        self.alone = False
        """Nothing comes in this round but there."""

    def begin(self, *, memory: bool, others: bool) -> None:
        """Another round. `memory`: there are events that come here; `others`: there are more."""
        dice = self._dice
        often = OFTEN[0] * (OFTEN[1] / OFTEN[0]) ** dice.random()
        self._here = (
            [
                [*place, {"load": often, "store": often}]
                for place in dice.sample(self._places, dice.randint(1, min(MOST_RECORDS, len(self._places))))
            ]
            if memory
            else []
        )
        self.alone = memory and dice.random() < (ALONE if others else MEMORY_ALONE)

    def comes(self, access: str, node: Any, at: int) -> bool:
        """Whether an event comes at this access, or behind it."""
        segment = self.segments.name(node)
        for each in self._here:
            if segment == each[0] and at in each[1]:
                if self._dice.random() >= each[2][access]:
                    return False
                each[2][access] = max(SELDOMER * each[2][access], SELDOM / len(self._here))
                return True
        return False
