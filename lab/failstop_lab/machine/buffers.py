"""Buffers: what a thread's processor of a weak machine has not let out yet, and how old its loads may be."""

from __future__ import annotations

from dataclasses import dataclass, field

from failstop_lab.machine.files import Regular
from failstop_lab.machine.process import Process, Thread

WORD_BYTES = 8
ALL, LAST, BUT_LAST, FIRST_HALF, SECOND_HALF, FIRST_HALF_BEFORE, SECOND_HALF_BEFORE = LATE = range(1, 8)
"""The stores that are late: some of those since the last barrier, or a half of the last one, or of the one before."""
EVERY, FIRST, BUT_FIRST, BEGIN_OF_FIRST, END_OF_FIRST, SAME_PLACE, REST_OF_PLACE = EARLY = range(1, 8)
"""The loads that are early: some up to the next barrier, or a half of the first one, or those of the place that was
looked at last before the pause, or those of the place that is looked at first behind it, but for its first word."""
HALVES = {
    FIRST_HALF: (-1, True),
    SECOND_HALF: (-1, False),
    FIRST_HALF_BEFORE: (-2, True),
    SECOND_HALF_BEFORE: (-2, False),
}
"""For each late half: (the store, counted from the last one as -1; whether it is the first half)."""


@dataclass(eq=False, slots=True)
class Store:
    """A store, or a part of one, and what was there before."""

    stamp: int
    """When others could see it."""
    process: Process
    node: Regular
    at: int
    before: bytes
    data: bytes
    made: int
    """Its stamp when it was made."""

    def cut(self, begin: int, end: int) -> Store:
        """A part of it."""
        before, data = self.before[begin:end], self.data[begin:end]
        return Store(self.stamp, self.process, self.node, self.at + begin, before, data, self.made)

    def half(self, *, first: bool) -> Store | None:
        """One half of it, between two words; None: it has but one."""
        half = len(self.data) // 2 // WORD_BYTES * WORD_BYTES
        if not half:
            return None
        return self.cut(0, half) if first else self.cut(half, len(self.data))

    def touches(self, other: Store) -> bool:
        """Whether both are of one word."""
        return self.node is other.node and self.at < other.at + len(other.data) and other.at < self.at + len(self.data)


@dataclass(eq=False, slots=True)
class View:
    """The state of one thread's processor."""

    since: list[Store] = field(default_factory=list)
    """Stores behind its last barrier that nobody can have seen."""
    late: list[Store] = field(default_factory=list)
    """Those that are taken back while it pauses."""
    released: int = -1
    """How many of `since` were made when it released a lock; -1: it has released none."""
    before: int = 0
    """Loads may be as old as this stamp, up to the next barrier; 0: they are new."""
    early: int = 0
    """Those of them that are, of EARLY."""
    loads: int = 0
    """How many there were since the pause."""
    seen: set[tuple[int, int]] = field(default_factory=set)
    """Places that were looked at since, and are not older at the next look."""
    last: tuple[int, int, int] = (0, 0, 0)
    """The bytes that were looked at last: the file's number, from where, to where."""
    again: tuple[int, int, int] = (0, 0, 0)
    """Those that are older at every look, of SAME_PLACE and REST_OF_PLACE."""

    def may_be_late(self, late: int) -> bool:
        """Whether there are stores that this, of LATE, says anything else of than another does."""
        if late in HALVES:
            number, _ = HALVES[late]
            return len(self.since) >= -number and len(self.since[number].data) > WORD_BYTES
        return len(self.since) > (late == BUT_LAST)


@dataclass(eq=False, slots=True)
class Race:
    """A store that waits until another process looks into the same file; that one's loads are early then."""

    thread: Thread
    node: Regular
    early: int
