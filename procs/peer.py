"""Peers: the processes that the port owner and the stopper watch for death."""

from __future__ import annotations

from failstop.board.interface import Board
from failstop.board.stop_port import StopPort
from failstop.messages import layout, records
from failstop.policy import causes
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs.context import Context
from failstop.procs.handover import Control
from failstop.procs.loop import READ, Loop
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import Lifeline

LEAVE_AFTER_NS = 150_000_000
"""How long the processes that write stops outlive the supervisor at least: the burst and its repeats on most boards."""
AFTER_LAST_NS = 30_000_000
"""How long they stay after the last repeat, so that it reaches the wire."""
LATEST_NS = 500_000_000
"""How long they stay at most for a port that still holds the stop, because the kernel drops the bytes at the last
close."""


def leave_after_ns(board: Board) -> int:
    """How long a writer of stops outlives the supervisor: until its board has had the last repeat."""
    return max(LEAVE_AFTER_NS, AFTER_LAST_NS + max((0, *(at_ns for row in board.repeats_ns for at_ns in row))))


DRAINED_NS = 5_000_000
"""How often to look at a port that still holds the stop."""
_LINE = 1
"""Which line in each process's block of futexes to use; the supervisor waits on line 0."""


class Parent:
    """The supervisor and the ports that it sends. When it dies, the watcher stops the robot and exits 150 ms later."""

    def __init__(self, context: Context, loop: Loop, line: int, port: StopPort, *, early: bool) -> None:
        """`line`: which of the supervisor's futexes to wait on; `port`: where this process writes its stops; `early`:
        the thread that first learns of the death writes the stop."""
        self._port = port
        self.life = Lifeline(context.parent)
        self.control = Control(context.fd("control"))
        self.orphaned_ns = 0
        """When its death was noticed; 0 while it lives."""
        self._loop = loop
        self._leave = loop.timer()
        context.early.watch_block(self.life, layout.SUPERVISOR_BLOCK, line, port.early_stop if early else None)
        for fd in (self.life.fd, self.control.fd):
            loop.watch(fd, READ)

    def died(self, ready: dict[int, int]) -> bool:
        """True when this wake-up, or the early news before it, reports the supervisor's death; until drop() answers
        it."""
        return not self.orphaned_ns and self.life.died(ready)

    def drop(self, now_ns: int) -> None:
        """Stop watching it: the stop for its death is written. Once the repeats are out, leave() returns True."""
        self.orphaned_ns = now_ns
        self._leave.set(now_ns + leave_after_ns(self._port.board))
        self._loop.forget(self.life.fd)
        self._loop.forget(self.control.fd)

    def leave(self, now_ns: int) -> bool:
        """True when it is time to exit, because the repeats are on the wire. It waits for a port that holds them back,
        but not long."""
        if not self._leave.due(now_ns):
            return False
        if now_ns - self.orphaned_ns < LATEST_NS and not self._port.lost and (self._port.unsent or self._port.holds()):
            self._leave.set(now_ns + DRAINED_NS)
            return False
        return True


class Peer:
    """One watched process. `life` is None while there is no process, or its death was already answered."""

    def __init__(self, name: str, context: Context, loop: Loop, port: StopPort) -> None:
        """`port`: where the thread that gets the early news of the death writes the stop."""
        self.death = causes.DIED(name)
        """The cause of the stop when this process dies."""
        self.heart = HeartbeatReader(context.segment(name))
        self.life: Lifeline | None = None
        self._word = context.segment("supervisor").word(f"{name}_life")
        self._early = context.early
        self._stop = port.early_stop
        self._priority = PROCESS_BY_NAME[name].priority
        self._loop = loop
        self._named = 0

    def named(self) -> int:
        """The pid of this process, as the supervisor publishes it; 0 before the process is first started."""
        return records.unpack_life(self._word.get())[0]

    def follow(self) -> int:
        """Watch the process that the supervisor names: by its pid at once, by its futex once it runs and so holds it.
        Returns the pid of the process before it if that death had not been noticed, else 0."""
        named = self._word.get()
        pid, block = records.unpack_life(named)
        died = 0
        if named != self._named:
            self._named = named
            died = self.life.pid if self.life and self.life.dead() else 0
            self.drop()
            try:
                self.life = Lifeline(pid)
            except ProcessLookupError:
                return died
            self._loop.watch(self.life.fd, READ)
        if self.life and not self.life.watched and self.heart.running(pid):
            self._early.watch_block(self.life, block, _LINE, lambda: self._stop_early(pid), self._priority)
        return died

    def _stop_early(self, pid: int) -> None:
        """Write the stop in the thread that waits. If the supervisor names another process by now, this death was
        already answered, and a thread that was held up must not cut into the motion that came after."""
        if self.named() == pid:
            self._stop()

    def runs(self) -> bool:
        """True from the moment when it has reported that it runs until its death has been answered."""
        return self.life is not None and self.life.watched

    def died(self, ready: dict[int, int]) -> int:
        """The pid of the process if this wake-up, or the early news before it, reports its death, else 0."""
        return self.life.pid if self.life and self.life.died(ready) else 0

    def drop(self) -> None:
        """Stop watching it."""
        if self.life:
            self._loop.forget(self.life.fd)
            self.life.close()
            self.life = None
