"""Pressing: a few records of shared memory in each round at which events of memory come far more often than elsewhere.

Two accesses whose order matters are met by chance once in some thousand rounds. Which records they are of is not told
here: each round draws some of all that a process acts on.
"""

from __future__ import annotations

from random import Random
from typing import Any

from failstop.lab.machine.memory import WeakMachine
from failstop.messages import layout

RECORDS = 3
"""So many in a round."""
OFTEN = (0.05, 0.8)
"""Between these is how often an event comes at an access to one of them."""
ALONE = 0.6
"""In so many rounds nothing else comes: what needs a certain moment is not moved by other events."""
READ_BY_NO_PROCESS = ("everyone", "clients", "its successor, clients")
"""Readers of records that decide nothing (messages/layout.py), but for the beats."""
BEAT = "beat_ns"


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


class Pressing:
    """What the rounds of a run press on."""

    def __init__(self, dice: Random, machine: WeakMachine) -> None:
        self._dice, self._machine = dice, machine
        self._here: list[tuple[str, range]] = []
        self._often = 0.0
        self.alone = False
        """Nothing comes in this round but there."""
        self._segments: dict[int, str] = {}
        """By a file's number: the segment that it is."""

    def begin(self, *, memory: bool) -> None:
        """Another round. `memory`: there are events that come here."""
        dice = self._dice
        self._here = dice.sample(PLACES, RECORDS) if memory else []
        self._often = OFTEN[0] * (OFTEN[1] / OFTEN[0]) ** dice.random()
        self.alone = memory and dice.random() < ALONE

    def comes(self, node: Any, at: int) -> bool:
        """Whether an event comes at this access, or behind it."""
        segment = self.segment(node)
        for name, place in self._here:
            if segment == name and at in place:
                return self._dice.random() < self._often
        return False

    def segment(self, node: Any) -> str:
        """The name of a file's segment; empty: it is none."""
        if node.number not in self._segments:
            files = self._machine.root.folder("/dev/shm").names.items()
            path = next((path for path, file in files if file is node), "")
            self._segments[node.number] = path.rpartition(".")[2]
        return self._segments[node.number]
