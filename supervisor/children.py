"""Children: what the supervisor knows of each process of the table."""

from __future__ import annotations

import os
import signal

from failstop.shm.lifeline import Lifeline

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.heartbeat import HeartbeatReader
    from failstop.supervisor.fence import Fence
    from failstop.supervisor.restarts import Restarts
    from failstop.supervisor.table import Process

_SIGNALS = {found.value: found.name for found in signal.Signals}
STARTING_NS = 5_000_000_000
"""A process that does not say that it runs within this time is killed."""


class Child:
    """One row of the process table as it is now."""

    __slots__ = (
        "beat",
        "block",
        "ended",
        "excused_ns",
        "fallen",
        "fence",
        "last_exit",
        "life",
        "patience_ns",
        "pid",
        "restart_ns",
        "restarts",
        "row",
        "started_ns",
        "times_restarted",
    )

    def __init__(self, row: Process, beat: HeartbeatReader, restarts: Restarts) -> None:
        self.row = row
        self.beat = beat
        self.restarts = restarts
        self.pid = 0
        self.block = 0
        """The block of mutexes that it holds."""
        self.fallen = False
        """Its death is known, and answered; it is still to be buried."""
        self.ended = False
        """Its pidfd has said so."""
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart_ns: int | None = None
        """When it is to be started again; None: it runs, or stays down."""
        self.fence: Fence | None = None
        """It was killed for hanging: when and how."""
        self.excused_ns = 0
        """Silence before this is not its own."""
        self.patience_ns = 0
        """What it is given beyond its deadline."""
        self.times_restarted = 0
        self.last_exit = ""

    def started(self, pid: int, block: int, now_ns: int) -> None:
        """It was just started. Raises OSError, and then nothing is changed."""
        self.life = Lifeline(pid)
        self.pid = pid
        self.block = block
        self.fallen = self.ended = False
        self.fence = None
        self.started_ns = now_ns
        self.restart_ns = None

    def running(self) -> bool:
        """True when it has said that it runs."""
        return self.pid != 0 and not self.fallen and not self.fence and self.beat.running(self.pid)

    def hangs(self, now_ns: int) -> bool:
        """True when its heartbeat, or its first one, is overdue."""
        overdue_ns = self.overdue_ns()
        return overdue_ns is not None and now_ns >= overdue_ns

    def overdue_ns(self) -> int | None:
        """When it counts as hanging unless it beats before; None: there is nothing to wait for."""
        if not self.pid or self.fence or self.fallen:
            return None
        if self.running():
            return max(self.beat.ns.get(), self.excused_ns) + self.row.deadline_ns + self.patience_ns
        return max(self.started_ns, self.excused_ns) + STARTING_NS

    def kill(self, wait_s: float) -> None:
        """End it, and collect it if it has ended within `wait_s`."""
        if self.life:
            self.life.kill()
            self.life.wait(wait_s)
            self.buried()

    def buried(self) -> str:
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
        return "down" if self.restart_ns is None else "waiting"
