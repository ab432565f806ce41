"""Children: what the supervisor knows of each process of the table."""

from __future__ import annotations

import os
import signal

from failstop.procs.loop import NEVER, Deadline
from failstop.shm.lifeline import Lifeline

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.processes import Process
    from failstop.shm.heartbeat import HeartbeatReader
    from failstop.supervisor.fence import Fence
    from failstop.supervisor.restarts import Restarts

_SIGNALS = {found.value: found.name for found in signal.Signals}
STARTING_NS = 5_000_000_000
"""A process that does not say that it runs within this time is killed."""


class Child:
    """One row of the process table as it is now."""

    __slots__ = (
        "beat",
        "block",
        "dead",
        "down",
        "ended",
        "excused_ns",
        "fence",
        "last_exit",
        "life",
        "pid",
        "restart",
        "restarts",
        "row",
        "spared_ns",
        "started_ns",
        "times_restarted",
    )

    def __init__(self, row: Process, beat: HeartbeatReader, restarts: Restarts, restart: Deadline) -> None:
        self.row = row
        self.beat = beat
        self.restarts = restarts
        self.pid = 0
        self.block = 0
        """The block of futexes that it holds."""
        self.dead = False
        """Its death is known, and answered; it is still to be reaped."""
        self.ended = False
        """Its pidfd has said so."""
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart = restart
        """When it is to be started again; never: it runs, or is down until a reset."""
        self.fence: Fence | None = None
        """It was killed for hanging: when and how."""
        self.excused_ns = 0
        """Silence before this is not its own."""
        self.spared_ns = 0
        """Its last sign of life before a silence that the machine explains, and that lasts; 0: there is none such."""
        self.down = False
        """The epoch in which it had died too often, and is down since; 0: it is not."""
        self.times_restarted = 0
        self.last_exit = ""

    def started(self, pid: int, block: int, now_ns: int) -> None:
        """It was just started. Raises OSError, and then nothing is changed."""
        self.life = Lifeline(pid)
        self.pid = pid
        self.block = block
        self.dead = self.ended = False
        self.fence = None
        self.started_ns = now_ns
        self.restart.set(NEVER)
        self.spared_ns = 0
        self.down = False

    def running(self) -> bool:
        """True when it has said that it runs."""
        return self.pid != 0 and not self.dead and not self.fence and self.beat.running(self.pid)

    def well(self) -> bool:
        """True when it runs, and the machine lets it."""
        return self.running() and not self.spared_ns

    def heard_ns(self) -> int:
        """Its last sign of life."""
        return max(self.beat.ns.get(), self.started_ns)

    def allowed_ns(self) -> int:
        """How long it may be silent: when it runs, or until it says so."""
        return self.row.deadline_ns if self.running() else STARTING_NS

    def spare(self, now_ns: int) -> None:
        """Its silence is the machine's: as long again from now on."""
        self.excused_ns = now_ns
        self.spared_ns = self.spared_ns or self.heard_ns()

    def hangs(self, now_ns: int) -> bool:
        """True when its heartbeat, or its first one, is overdue."""
        return now_ns >= self.overdue_ns()

    def overdue_ns(self) -> int:
        """When it counts as hanging unless it beats before; NEVER: there is nothing to wait for."""
        if not self.pid or self.fence or self.dead:
            return NEVER
        sign_ns = self.beat.ns.get() if self.running() else self.started_ns
        return max(sign_ns, self.excused_ns) + self.allowed_ns()

    def kill(self, wait_s: float) -> None:
        """End it, and collect it if it has ended within `wait_s`."""
        if self.life:
            self.life.kill()
            self.life.wait(wait_s)
            self.reap()

    def reap(self) -> str:
        """Collect the dead process and return how it died, in words; empty: it can't be collected yet, as while a
        debugger holds it."""
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if not pid:
            return ""
        if os.WIFSIGNALED(status):
            number = os.WTERMSIG(status)
            self.last_exit = f"killed by {_SIGNALS.get(number, number)}"
        else:
            self.last_exit = f"exited with code {os.waitstatus_to_exitcode(status)}"
        if self.life:
            self.life.close()
            self.life = None
        self.pid = 0
        self.ended = False
        return self.last_exit

    def state(self) -> str:
        """In one word: running, starting, waiting (to be restarted) or down."""
        if self.pid:
            return "running" if self.running() else "starting"
        return "down" if self.down else "waiting"
