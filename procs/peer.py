"""Peers: the processes that the port owner and the stopper watch for death, including the supervisor (Parent)."""

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
"""The shortest time for which the port owner and the stopper stay alive after the supervisor's death, in ns. On most
boards this is enough for the burst and its repeats."""
AFTER_LAST_NS = 30_000_000
"""How long the port owner and the stopper stay alive after they have written the last repeat of a stop, so that its
bytes leave the port."""
LATEST_NS = 500_000_000
"""The longest time for which the port owner and the stopper stay alive after the supervisor's death, in ns. Each
of them waits while its port still holds bytes of the stop, because the kernel drops these bytes when the last process
closes the port."""


def leave_after_ns(board: Board) -> int:
    """Return how long, at least, the port owner and the stopper stay alive after the supervisor's death, in ns. In this
    time, the board receives the last repeat of the stop."""
    return max(LEAVE_AFTER_NS, AFTER_LAST_NS + max((0, *(at_ns for row in board.repeats_ns for at_ns in row))))


DRAINED_NS = 5_000_000
"""How often to check whether the port still holds the stop."""
_LINE = 1
"""The number of the futex on which a Peer waits. Each watched process has a block of futexes, one for each process that
watches it. Such a futex is called a line. In the blocks that a Peer uses, line 0 is for the supervisor."""


class Parent:
    """Watches the supervisor, and receives the ports that it sends. When the supervisor dies, this process stops the
    robot and exits soon afterwards."""

    def __init__(self, context: Context, loop: Loop, line: int, port: StopPort, *, early: bool) -> None:
        """`line`: the line of the supervisor's futexes on which to wait (see _LINE). `port`: the port for this
        process's stops. `early`: True if the thread that waits for the supervisor's death writes a stop at once."""
        self._port = port
        self.life = Lifeline(context.parent)
        self.control = Control(context.fd("control"))
        self.orphaned_ns = 0
        """The time when the supervisor's death was noticed, or 0 while it is alive."""
        self._loop = loop
        self._leave = loop.timer()
        context.early.watch_block(self.life, layout.SUPERVISOR_BLOCK, line, port.early_stop if early else None)
        for fd in (self.life.fd, self.control.fd):
            loop.watch(fd, READ)

    def died(self, ready: dict[int, int]) -> bool:
        """Return True if the supervisor has died, as this wake-up or an early report before it shows. False after
        drop()."""
        return not self.orphaned_ns and self.life.died(ready)

    def drop(self, now_ns: int) -> None:
        """Stop watching the supervisor. Call it when the stop for its death was written. leave() then says when to
        exit."""
        self.orphaned_ns = now_ns
        self._leave.set(now_ns + leave_after_ns(self._port.board))
        self._loop.forget(self.life.fd)
        self._loop.forget(self.control.fd)

    def leave(self, now_ns: int) -> bool:
        """Return True when it is time to exit: after the stop's repeats have left the port, but at most LATEST_NS after
        the supervisor's death."""
        if not self._leave.due(now_ns):
            return False
        if now_ns - self.orphaned_ns < LATEST_NS and not self._port.lost and (self._port.unsent or self._port.holds()):
            self._leave.set(now_ns + DRAINED_NS)
            return False
        return True


class Peer:
    """Watches one process for death. `life` is the lifeline of this process. It is None until the process is started,
    and again after the stop for its death was written."""

    def __init__(self, name: str, context: Context, loop: Loop, port: StopPort) -> None:
        """`port`: the port to which a thread writes the stop as soon as it learns of the death."""
        self.death = causes.DIED(name)
        """The cause of the stop if this process dies."""
        self.heart = HeartbeatReader(context.segment(name))
        self.life: Lifeline | None = None
        self._word = context.segment("supervisor").word(f"{name}_life")
        self._early = context.early
        self._stop = port.early_stop
        self._priority = PROCESS_BY_NAME[name].priority
        self._loop = loop
        self._named = 0

    def named(self) -> int:
        """Return the pid that the supervisor has published for the process, or 0 before its first start."""
        return records.unpack_life(self._word.get())[0]

    def follow(self) -> int:
        """Watch the process whose pid the supervisor publishes. Its pidfd is watched at once, and its futex when the
        process has reported that it runs. Returns the pid of the previous process if its death was not noticed,
        otherwise 0."""
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
        """Write the stop for the death of the process `pid`, in the thread that waits for this death. A thread that was
        held up may come too late. So nothing is written if the supervisor has already published the next process,
        because motion may have been enabled since."""
        if self.named() == pid:
            self._stop()

    def runs(self) -> bool:
        """Return True from the time when the process reports that it runs, until drop()."""
        return self.life is not None and self.life.watched

    def died(self, ready: dict[int, int]) -> int:
        """Return the pid of the process if it has died, as this wake-up or an early report before it shows; otherwise
        0."""
        return self.life.pid if self.life and self.life.died(ready) else 0

    def drop(self) -> None:
        """Stop watching the process."""
        if self.life:
            self._loop.forget(self.life.fd)
            self.life.close()
            self.life = None
