"""Children: starting a process of the table, and what the supervisor knows of it."""

from __future__ import annotations

import os
import signal
import sys

from failstop.procs.child import PATH_VARIABLE
from failstop.procs.context import SETTINGS_VARIABLE
from failstop.shm.lifeline import Lifeline

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.heartbeat import HeartbeatReader
    from failstop.supervisor.restarts import Restarts
    from failstop.supervisor.table import Process

_SIGNALS = {found.value: found.name for found in signal.Signals}
STARTING_NS = 5_000_000_000
"""A process that does not say that it runs within this time is killed."""


class Starter:
    """What every start has in common."""

    __slots__ = ("_common", "_environment", "_script")

    def __init__(self, name: str, incarnation: int, runtime_dir: str, settings_lines: str) -> None:
        package = os.path.dirname(os.path.dirname(os.path.abspath(sys.modules["failstop.procs.child"].__file__ or "")))
        path = [entry for entry in sys.path if entry and os.path.isabs(entry)]
        self._script = os.path.join(package, "procs", "child.py")
        self._common = [f"name={name}", f"run={incarnation:x}", f"dir={runtime_dir}", f"parent={os.getpid()}"]
        self._environment = {
            PATH_VARIABLE: os.pathsep.join([os.path.dirname(package), *path]),
            SETTINGS_VARIABLE: settings_lines,
            "LANG": "C.UTF-8",
        }

    def start(self, row: Process, descriptors: dict[str, int]) -> int:
        """Start a process with these descriptors (-1: none) and return its pid. Raises OSError."""
        words = [f"{key}={descriptors[key]}" for key in row.descriptors]
        passed = [descriptors[key] for key in row.descriptors if descriptors[key] >= 0]
        arguments = [sys.executable, "-I", "-S", self._script, row.name, *self._common, *words]
        for fd in passed:
            os.set_inheritable(fd, True)
        try:
            # A terminal's Ctrl-C goes to the whole group; stopping in order is the supervisor's business.
            return os.posix_spawn(sys.executable, arguments, self._environment, setsigmask=[signal.SIGINT])
        finally:
            for fd in passed:
                os.set_inheritable(fd, False)


class Child:
    """One row of the process table as it is now."""

    __slots__ = (
        "beat",
        "fenced",
        "last_exit",
        "life",
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
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart_ns: int | None = None
        """When it is to be started again; None: it runs, or stays down."""
        self.fenced = False
        """It was killed for hanging, and its death is still to come."""
        self.times_restarted = 0
        self.last_exit = ""

    def started(self, pid: int, now_ns: int) -> None:
        """It was just started."""
        self.pid = pid
        self.fenced = False
        self.life = Lifeline(pid)
        self.started_ns = now_ns
        self.restart_ns = None

    def running(self) -> bool:
        """True when it has said that it runs."""
        return self.pid != 0 and self.beat.running(self.pid)

    def hangs(self, now_ns: int) -> bool:
        """True when its heartbeat, or its first one, is overdue."""
        if not self.pid or self.fenced:
            return False
        if self.running():
            return self.beat.age_ns(now_ns) > self.row.deadline_s * 1e9
        return now_ns - self.started_ns > STARTING_NS

    def buried(self) -> str:
        """Collect the dead process and return how it died, in words."""
        _, status = os.waitpid(self.pid, 0)
        if os.WIFSIGNALED(status):
            number = os.WTERMSIG(status)
            self.last_exit = f"killed by {_SIGNALS.get(number, number)}"
        else:
            self.last_exit = f"exited with code {os.waitstatus_to_exitcode(status)}"
        if self.life:
            self.life.close()
            self.life = None
        self.pid = 0
        return self.last_exit

    def state(self) -> str:
        """In one word: running, starting, waiting (to be restarted) or down."""
        if self.pid:
            return "running" if self.running() else "starting"
        return "down" if self.restart_ns is None else "waiting"
