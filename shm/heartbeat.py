"""Heartbeat: what each process says of itself in words of its own segment, once a turn of its loop."""

from __future__ import annotations

from time import process_time_ns

STARTING = 1
RUNNING = 2
STOPPING = 3
STATES = {0: "absent", STARTING: "starting", RUNNING: "running", STOPPING: "stopping"}

REALTIME = 1
MEMORY_LOCKED = 2
EARLY_NEWS = 4
"""The kernel tells of deaths before it takes the memory down (futex.proven)."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.segment import Segment


class Heartbeat:
    """The writing side. Only the segment's own process beats; a successor starts again."""

    __slots__ = ("_cpu_ns", "_epoch", "_last_ns", "_loops", "_loops_word", "_ns", "_state", "_worst", "_worst_ns")

    def __init__(self, own: Segment, pid: int, rights: int, now_ns: int) -> None:
        self._ns = own.word("beat_ns")
        self._cpu_ns = own.word("beat_cpu_ns")
        self._loops_word = own.word("beat_loops")
        self._worst = own.word("beat_worst_ns")
        self._epoch = own.word("beat_epoch")
        self._state = own.word("beat_state")
        self._loops = 0
        self._worst_ns = 0
        self._last_ns = now_ns
        for word in (self._loops_word, self._worst, self._epoch):
            word.set(0)
        self._state.set(STARTING)
        own.word("beat_rights").set(rights)
        self._cpu_ns.set(process_time_ns())
        own.word("beat_pid").set(pid)
        self._ns.set(now_ns)

    def beat(self, now_ns: int, epoch: int) -> None:
        """One turn of the loop."""
        gap = now_ns - self._last_ns
        self._last_ns = now_ns
        if gap > self._worst_ns:
            self._worst_ns = gap
            self._worst.set(gap)
        self._loops += 1
        self._loops_word.set(self._loops)
        self._epoch.set(epoch)
        self._cpu_ns.set(process_time_ns())
        self._ns.set(now_ns)

    def state(self, state: int, now_ns: int) -> None:
        """Publish STARTING, RUNNING or STOPPING. A start that took long was no silence."""
        self._cpu_ns.set(process_time_ns())
        self._ns.set(now_ns)
        self._state.set(state)


class HeartbeatReader:
    """The watching side of one process's heartbeat."""

    __slots__ = ("cpu_ns", "epoch", "loops", "ns", "pid", "rights", "state", "worst_ns")

    def __init__(self, segment: Segment) -> None:
        self.ns = segment.word("beat_ns")
        self.cpu_ns = segment.word("beat_cpu_ns")
        self.loops = segment.word("beat_loops")
        self.worst_ns = segment.word("beat_worst_ns")
        self.pid = segment.word("beat_pid")
        self.epoch = segment.word("beat_epoch")
        self.state = segment.word("beat_state")
        self.rights = segment.word("beat_rights")

    def age_ns(self, now_ns: int) -> int:
        """Time since the last beat; a beat that came after `now_ns` was taken counts as age 0."""
        return max(0, now_ns - self.ns.get())

    def running(self, pid: int) -> bool:
        """True when the process with this pid has said that it runs."""
        return self.pid.get() == pid and self.state.get() == RUNNING
