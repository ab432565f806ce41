"""Lifelines report the death of a process, so that a loop can wait for it together with everything else.

Each death is reported twice, and one report is enough. The early report comes from a robust futex that the process
holds (futex.py): a thread waits on it, marks the lifeline as dead and rings a bell. The late report comes from a pidfd.
The watched process can't prevent it, and it still means the same process if the pid is used again. Neither report shows
a hang; heartbeats do (heartbeat.py).
"""

from __future__ import annotations

# The C module under `signal`, which costs an import of enum.
import _signal
import _thread
import contextlib
import os
import select
from collections.abc import Callable
from time import sleep

from failstop.shm import futex
from failstop.shm.bell import EventBell
from failstop.shm.futex import Futex
from failstop.shm.segment import Segment

Stops = Callable[[], None] | None
_SIGKILL = 9
_ORDINARY = os.sched_param(0)
_DEMOTED = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
"""The scheduling policy of a demoted process. It keeps the flag SCHED_RESET_ON_FORK, which failstop's processes have
(procs/rights.py), because only CAP_SYS_NICE may clear that flag."""
_STACK_BYTES = 128 * 1024
_QUIET_S = 0.02
_WAY_S = 30e-6


def give_way() -> None:
    """Sleep for a moment after a stop was written, so that its bytes get out. For a pty, and for a driver that uses a
    kernel thread, a thread of lower priority carries the bytes, and it may be waiting for this core."""
    sleep(_WAY_S)


def pid_namespace() -> int:
    """The pid namespace of this process, or 0 if it is not known. In a different namespace, the same pid means no
    process or a different one."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return 0


class Lifeline:
    """Watches one process for death. `fd` becomes readable when the process has died, and stays readable."""

    def __init__(self, pid: int = 0) -> None:
        """`pid`: the process to watch. 0 means a process whose pid is not known here, for example because it runs in a
        container; then only the early report can come. Raises ProcessLookupError if no such process exists."""
        self.pid = pid
        self.fd = os.pidfd_open(pid) if pid else os.eventfd(0, os.EFD_CLOEXEC)
        self.watched = False
        self.early: Futex | None = None
        """The futex on which a thread waits for the early report, or None if the process is not watched yet."""
        self.marked = False
        """True once the early report has come."""

    def died(self, ready: dict[int, int]) -> bool:
        """True if this wake-up, or an early report before it, says that the process has died."""
        return self.marked or self.fd in ready

    def dead(self) -> bool:
        """True once the process has died. It is already true when the death has had no other effect yet. It takes two
        system calls and never blocks."""
        return self.marked or (self.early is not None and self.early.owner_died()) or self.wait(0)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the process has ended. Returns False if it has not ended within `timeout_s`."""
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))

    def kill(self) -> None:
        """Send SIGKILL to the process. If its pid has been given to another process, that process is not killed."""
        with contextlib.suppress(OSError):
            _signal.pidfd_send_signal(self.fd, _SIGKILL)

    def demote(self) -> None:
        """Take real-time priority from every thread of the dying process. Call it when the stop is written.

        The kernel needs half a millisecond or more to free the process's memory. If it did so at real-time priority,
        its own workers could not use that core, and one of them may be carrying the stop.
        """
        with contextlib.suppress(OSError):
            for thread in os.listdir(f"/proc/{self.pid}/task"):
                with contextlib.suppress(OSError):
                    os.sched_setscheduler(int(thread), _DEMOTED, _ORDINARY)

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1
            if self.early:
                self.early.wake()


class EarlyNews:
    """This process's threads that wait for early reports of deaths. `bell` rings after a lifeline was marked as
    dead."""

    def __init__(self, lifelines: Segment) -> None:
        """The threads will have the scheduling policy and priority that this process has now."""
        self._lifelines = lifelines
        self._policy = (os.sched_getscheduler(0), os.sched_getparam(0))
        self.bell = EventBell.create()
        _thread.stack_size(_STACK_BYTES)

    def watch_block(self, life: Lifeline, block: int, watcher: int, stop: Stops = None, dying: int = 0) -> None:
        """Watch a process of the service that already holds the block of futexes `block`. `watcher`: the line in it."""
        self.watch(life, self._lifelines, block * futex.PER_BLOCK + watcher, stop, dying)

    def watch(self, life: Lifeline, segment: Segment, line: int = 0, stop: Stops = None, dying: int = 0) -> None:
        """Start a thread that waits until the process that holds the futex line `line` dies. Only one thread is started
        per lifeline. It ends when the lifeline is closed.

        `stop`: the thread calls this before the bell rings, and then sleeps for a moment so that the stop's bytes get
        out. `dying`: the priority of the watched process. If this process has real-time rights, a thread with a `stop`
        gets a higher priority than that. Otherwise, on a computer with one core, it would have to wait until the kernel
        has freed the dying process.
        """
        if not life.watched:
            life.watched = True
            # If the machine is out of threads or memory, no thread starts, and only the late report comes.
            with contextlib.suppress(RuntimeError, OSError):
                life.early = segment.futex("held", line)
                _thread.start_new_thread(self._wait, (life, life.early, stop, dying))

    def _wait(self, life: Lifeline, word: Futex, stop: Stops, dying: int) -> None:
        # Set the scheduling again: a new thread does not inherit it, because of SCHED_RESET_ON_FORK.
        policy, own = self._policy
        os.sched_setscheduler(0, policy, own)
        if stop and 0 < own.sched_priority <= dying:
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(0, policy, os.sched_param(dying + 1))
        if word.wait_for_death(lambda: life.fd >= 0):
            life.marked = True
            if stop:
                stop()
                life.demote()
                give_way()
            self.bell.ring()
            # The thread that handles the death needs the interpreter's lock now. The rest of this method would take the
            # lock three times, so it waits.
            sleep(_QUIET_S)
        word.close()
