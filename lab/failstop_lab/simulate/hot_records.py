"""Hot records: in each round, a few records of shared memory where events of memory are far more frequent than
elsewhere.

By chance alone, two accesses whose order matters would meet once in some thousand rounds. Each round draws some of the
records that a process acts on, and more often those that order.py judges.
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
"""The most hot records in a round; there is at least one."""
OFTEN = (0.3, 0.95)
"""The range of the probability of an event at a store, or a load, of a hot record."""
SELDOMER, SELDOM = 0.5, 0.5
"""After each event at a record the probability there falls by this factor, but for all hot records together never below
the second number, because some are accessed at every turn."""
ALONE, MEMORY_ALONE = 0.6, 0.9
"""The share of rounds without other events, which could move the moment that a failure needs. The second is for runs in
which only memory is odd."""
READ_BY_NO_PROCESS = ("everyone", "clients", "its successor, clients")
"""Readers (messages/layout.py) that decide nothing by a record, except by the beats."""
BEAT = "beat_ns"


def _begin(segment: str, name: str) -> int:
    return layout.SEGMENT_BY_NAME[segment].offsets[name]


def _records() -> list[tuple[str, range]]:
    """The segment and the byte range of each record that other processes act on; numbered records are one range."""
    found: dict[tuple[str, str], range] = {}
    for spec in layout.SEGMENTS:
        for name, record in spec.records.items() if spec.mode == layout.PUBLIC else ():
            if record.readers not in READ_BY_NO_PROCESS or name == BEAT:
                begin, key = spec.offsets[name], (spec.name, name.rstrip("0123456789"))
                found[key] = range(found.get(key, range(begin, begin)).start, begin + record.size())
    return [(segment, place) for (segment, _), place in found.items()]


RECORDS = _records()
JUDGED = {
    number
    for number, (segment, place) in enumerate(RECORDS)
    if any(each[0] == segment and _begin(*each) in place for each in (name.split(".", 1) for name in NAMED))
}
"""The records whose order order.py judges."""
JUDGED_TOO = 2
"""How many more times these are drawn than others."""


class Segments:
    """The names of a machine's segments, by their files."""

    def __init__(self, machine: WeakMachine) -> None:
        self._machine = machine
        self._names: dict[int, str] = {}
        """The names by the number of the file."""

    def name(self, node: Any) -> str:
        """The name of the segment in this file; empty if it is none."""
        if node.number not in self._names:
            self._names[node.number] = shared_path(self._machine, node).rpartition(".")[2]
        return self._names[node.number]

    def records(self, node: Any, at: int) -> list[int]:
        """The numbers in RECORDS of the record at this place: one or none."""
        segment = self.name(node)
        return [number for number, (name, place) in enumerate(RECORDS) if name == segment and at in place]


class StoredRecords:
    """The records that a run without events stores, because only those can be hot."""

    def __init__(self, machine: WeakMachine) -> None:
        self._segments = Segments(machine)
        self.records: set[int] = set()
        machine.at_seam = self._at

    def _at(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        if call == "store":
            self.records.update(self._segments.records(about[0], about[1]))


class HotRecords:
    """The hot records of each round of a run, chosen from `records`."""

    def __init__(self, dice: Random, machine: WeakMachine, records: Collection[int]) -> None:
        self._dice, self.segments = dice, Segments(machine)
        here = sorted(records)
        self._records = [
            RECORDS[number] for number in (*here, *(JUDGED_TOO * [each for each in here if each in JUDGED]))
        ]
        self._here: list[list[Any]] = []
        """The segment, the byte range in it, and the present probability of an event there, by the access."""
        self.alone = False
        """True if this round has events at hot records only."""

    def begin(self, *, memory: bool, others: bool) -> None:
        """Begin a round. `memory`: events of memory are on; `others`: other events are on too."""
        dice = self._dice
        often = OFTEN[0] * (OFTEN[1] / OFTEN[0]) ** dice.random()
        self._here = (
            [
                [*place, {"load": often, "store": often}]
                for place in dice.sample(self._records, dice.randint(1, min(MOST_RECORDS, len(self._records))))
            ]
            if memory
            else []
        )
        self.alone = memory and dice.random() < (ALONE if others else MEMORY_ALONE)

    def comes(self, access: str, node: Any, at: int) -> bool:
        """Whether an event comes at this access, or after it."""
        segment = self.segments.name(node)
        for each in self._here:
            if segment == each[0] and at in each[1]:
                if self._dice.random() >= each[2][access]:
                    return False
                each[2][access] = max(SELDOMER * each[2][access], SELDOM / len(self._here))
                return True
        return False
