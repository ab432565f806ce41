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
"""How long the stop's writers outlive the supervisor at least: the burst and its repeats, at most boards."""
AFTER_LAST_NS = 30_000_000
"""How long they stay after the last repeat, so that it is on the wire."""
LATEST_NS = 500_000_000
"""How long they stay at most for a port that still holds the stop: the kernel drops it at the last close."""


def leave_after_ns(board: Board) -> int:
    """How long a writer of stops outlives the supervisor: until its board has had the last repeat."""
    return max(LEAVE_AFTER_NS, AFTER_LAST_NS + max((0, *(at_ns for row in board.repeats_ns for at_ns in row))))


DRAINED_NS = 5_000_000
"""How often a port that still holds the stop is looked at."""
_LINE = 1
"""In each process's block of futexes; line 0 is the supervisor's to wait on."""


class Parent:
    """The supervisor, and the ports that it hands down. Its death is the end of who watches it too, later."""

    def __init__(self, context: Context, loop: Loop, line: int, port: StopPort, *, early: bool) -> None:
        """`line`: of the supervisor's futexes, to wait on; `port`: where this process writes its stops; `early`: the
        thread that learns of the death first stops on it."""
        self._port = port
        self.life = Lifeline(context.parent)
        self.control = Control(context.fd("control"))
        self.orphaned_ns = 0
        """When its death was noticed; 0: it lives."""
        self._loop = loop
        self._leave = loop.timer()
        context.early.watch_block(self.life, layout.SUPERVISOR_BLOCK, line, port.early_stop if early else None)
        for fd in (self.life.fd, self.control.fd):
            loop.watch(fd, READ)

    def died(self, ready: dict[int, int]) -> bool:
        """True when this wake-up, or the early news before it, says that it has died; until that is answered."""
        return not self.orphaned_ns and self.life.died(ready)

    def drop(self, now_ns: int) -> None:
        """Watch it no longer: the stop for it is written and repeated, then it is time to leave()."""
        self.orphaned_ns = now_ns
        self._leave.set(now_ns + leave_after_ns(self._port.board))
        self._loop.forget(self.life.fd)
        self._loop.forget(self.control.fd)

    def leave(self, now_ns: int) -> bool:
        """True when it is time to exit: the repeats are written and on the wire. A port that holds them back is waited
        for, but not long."""
        if not self._leave.due(now_ns):
            return False
        if now_ns - self.orphaned_ns < LATEST_NS and not self._port.lost and (self._port.unsent or self._port.holds()):
            self._leave.set(now_ns + DRAINED_NS)
            return False
        return True


class Peer:
    """`life` is None while there is none, or none whose death has not been answered."""

    def __init__(self, name: str, context: Context, loop: Loop, port: StopPort) -> None:
        """`port`: on which the thread stops that the early news of its death comes to."""
        self.death = causes.DIED(name)
        """The cause of a stop for its death."""
        self.heart = HeartbeatReader(context.segment(name))
        self.life: Lifeline | None = None
        self._word = context.segment("supervisor").word(f"{name}_life")
        self._early = context.early
        self._stop = port.early_stop
        self._priority = PROCESS_BY_NAME[name].priority
        self._loop = loop
        self._named = 0

    def named(self) -> int:
        """The pid that the supervisor names; 0 before the first."""
        return records.unpack_life(self._word.get())[0]

    def follow(self) -> int:
        """Watch whom the supervisor names: by its pid at once, by its futex once it runs and so holds it. Returns the
        pid of the one before when its death had not been noticed, else 0."""
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
        """In the thread that waits. Where another is named by now, somebody has stopped for this one: who was held up
        for so long must not cut into the motion that came after."""
        if self.named() == pid:
            self._stop()

    def runs(self) -> bool:
        """True from when it has said that it runs until its death is answered."""
        return self.life is not None and self.life.watched

    def died(self, ready: dict[int, int]) -> int:
        """Its pid when this wake-up, or the early news before it, says that it has died, else 0."""
        return self.life.pid if self.life and self.life.died(ready) else 0

    def drop(self) -> None:
        """Watch it no longer."""
        if self.life:
            self._loop.forget(self.life.fd)
            self.life.close()
            self.life = None
