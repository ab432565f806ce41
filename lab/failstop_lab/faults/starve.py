"""Starve: keep one process from being run, as a machine with too much to do does."""

from __future__ import annotations

import contextlib
import os
from types import TracebackType

from failstop.procs import rights
from failstop_lab.faults.crowd import Helper, spin_for_ever

HOGS = 12
"""Beside so many, on one core, the scheduler gives one of the lowest priority next to nothing."""
SHARP = -10
"""Niceness of hogs that leave it nothing at all for seconds; root's alone, and hard on whoever else is on that core."""


class Starved:
    """A context manager: within it the process waits, runnable, for a core that others have. That takes no rights, but
    to give a process its real-time rights back."""

    def __init__(self, pid: int, nice: int = 0) -> None:
        """`nice`: the hogs' niceness, as far as this user may choose it."""
        self._pid = pid
        self._nice = nice
        self._own_cores = os.sched_getaffinity(0)
        self._cores = os.sched_getaffinity(pid)
        self._policy, self._parameter = os.sched_getscheduler(pid), os.sched_getparam(pid)
        self._hogs: list[Helper] = []

    def __enter__(self) -> Starved:
        """The process keeps to one core, at the lowest priority, beside the hogs; who is to end them keeps off it."""
        core = {max(self._cores)}
        parent = os.getpid()
        os.sched_setaffinity(0, self._own_cores - core or self._own_cores)
        self._hogs = [Helper(lambda: _spin_in_a_session(parent, self._nice)) for _ in range(HOGS)]
        for hog in self._hogs:
            os.sched_setaffinity(hog.pid, core)
        os.sched_setaffinity(self._pid, core)
        os.sched_setscheduler(self._pid, os.SCHED_IDLE | self._policy & os.SCHED_RESET_ON_FORK, os.sched_param(0))
        _favour(self._pid, 19)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def end(self) -> None:
        """Let it run again, as before."""
        while self._hogs:
            self._hogs.pop().end()
        os.sched_setaffinity(0, self._own_cores)
        with contextlib.suppress(ProcessLookupError):  # it may have been ended meanwhile
            _favour(self._pid, 0)
            os.sched_setaffinity(self._pid, self._cores)
            os.sched_setscheduler(self._pid, self._policy, self._parameter)


def _favour(pid: int, nice: int) -> None:
    """Where sessions share the cores, the niceness of a process is nothing beside that of its session; one of the
    session that this process is of keeps it, since the terminal would be starved with it."""
    if pid != os.getpid() and os.getsid(pid) == os.getsid(0):
        return
    with contextlib.suppress(OSError), open(f"/proc/{pid}/autogroup", "w", encoding="ascii") as file:
        file.write(str(nice))


def _spin_in_a_session(parent: int, nice: int) -> None:
    rights.die_with_parent(parent)
    os.setsid()
    _favour(os.getpid(), nice)
    spin_for_ever()
