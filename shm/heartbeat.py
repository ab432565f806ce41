"""Heartbeat: what each process reports about itself once per turn of its loop. The values are words in the process's
own segment."""

from __future__ import annotations

from time import process_time_ns

from failstop.shm.segment import Segment

BEAT_STARTING, BEAT_RUNNING, BEAT_STOPPING = range(1, 4)
STATES = {0: "absent", BEAT_STARTING: "starting", BEAT_RUNNING: "running", BEAT_STOPPING: "stopping"}

REALTIME, MEMORY_LOCKED, EARLY_NEWS = 1, 2, 4
"""Bits for what a process has: real-time rights, locked memory, and early news of deaths. EARLY_NEWS: the kernel
reports a death before it frees the dead process's memory (futex.proven)."""


class HeartbeatReader:
    """Reads the heartbeat of a process, so that another process can watch it."""

    def __init__(self, segment: Segment) -> None:
        self.ns = segment.word("beat_ns")
        self.cpu_ns = segment.word("beat_cpu_ns")
        self.worst_ns = segment.word("beat_worst_ns")
        self.pid = segment.word("beat_pid")
        self.state = segment.word("beat_state")
        self.rights = segment.word("beat_rights")

    def age_ns(self, now_ns: int) -> int:
        """The time since the last beat, ns. 0 if a beat came after `now_ns` was read."""
        return max(0, now_ns - self.ns.get())

    def running(self, pid: int) -> bool:
        """True if the process with this pid has reported that it runs."""
        return self.pid.get() == pid and self.state.get() == BEAT_RUNNING


class Heartbeat:
    """Writes the heartbeat of a process. Only the process that owns the segment may use this. When a process is
    restarted, its heartbeat starts with fresh values."""

    def __init__(self, own: Segment, pid: int, rights: int, now_ns: int) -> None:
        self._words = words = HeartbeatReader(own)
        self._worst_ns = 0
        self.last_ns = now_ns
        words.worst_ns.set(0)
        words.state.set(BEAT_STARTING)
        words.rights.set(rights)
        words.cpu_ns.set(process_time_ns())
        words.pid.set(pid)
        words.ns.set(now_ns)

    def beat(self, now_ns: int) -> None:
        """Publish that one turn of the loop was made at `now_ns`."""
        words, gap_ns = self._words, now_ns - self.last_ns
        self.last_ns = now_ns
        if gap_ns > self._worst_ns:
            self._worst_ns = gap_ns
            words.worst_ns.set(gap_ns)
        words.cpu_ns.set(process_time_ns())
        words.ns.set(now_ns)

    def state(self, state: int, now_ns: int) -> None:
        """Publish the state BEAT_STARTING, BEAT_RUNNING or BEAT_STOPPING, and beat. The time since the previous beat
        does not count for `worst_ns`, the longest silence."""
        self.last_ns = now_ns
        self.beat(now_ns)
        self._words.state.set(state)
