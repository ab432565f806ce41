"""Lifelines: report the death of a process, so that it can be waited for together with everything else.

The early report comes from a robust futex that the process holds (futex.py): a thread waits on it, marks the lifeline
as dead and rings a bell. The late report comes from a pidfd; the watched process can't prevent it, and a pid that is
used again can't confuse it. One of the two reports is enough. Neither of them shows a hang; heartbeats do.
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
"""The scheduling policy of a demoted process, with the flag that failstop's processes have (procs/rights.py), because
only CAP_SYS_NICE may clear that flag."""
_STACK_BYTES = 128 * 1024
_QUIET_S = 0.02
_WAY_S = 30e-6


def give_way() -> None:
    """Sleep for a moment after a stop was written. Bytes for a pty, or for a driver that uses a kernel thread, are
    carried by a thread of lower priority, which may be waiting for this core."""
    sleep(_WAY_S)


def pid_namespace() -> int:
    """The pid namespace of this process; 0 if not known. In another namespace its pid belongs to no process, or to a
    different one."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return 0


class Lifeline:
    """Watches one process. `fd` becomes readable when the process has died; it then stays readable."""

    def __init__(self, pid: int = 0) -> None:
        """`pid` 0: a process whose number is not known here, for example in a container, so only the early news can
        report its death. Raises ProcessLookupError if no such process exists."""
        self.pid = pid
        self.fd = os.pidfd_open(pid) if pid else os.eventfd(0, os.EFD_CLOEXEC)
        self.watched = False
        self.early: Futex | None = None
        """The futex on which a thread waits for the early report of the death; None before it is watched."""
        self.marked = False
        """True once the early report has come."""

    def died(self, ready: dict[int, int]) -> bool:
        """True when this wake-up, or the early news before it, reports that the process has died."""
        return self.marked or self.fd in ready

    def dead(self) -> bool:
        """True once the process has died. This is true before anything ends because of the death. It takes two system
        calls and never blocks."""
        return self.marked or (self.early is not None and self.early.owner_died()) or self.wait(0)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the process has ended; False if it has not within `timeout_s`."""
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))

    def kill(self) -> None:
        """Send the process SIGKILL, but never another process that has got its pid in the meantime."""
        with contextlib.suppress(OSError):
            _signal.pidfd_send_signal(self.fd, _SIGKILL)

    def demote(self) -> None:
        """Take real-time rights from every thread of the dying process; call when the stop is out.

        The kernel needs half a millisecond or more to free its memory. At real-time priority that keeps a core from the
        kernel's own workers, one of which may be carrying the stop.
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
    """The threads of this process that wait for deaths. `bell` rings after a lifeline was marked."""

    def __init__(self, lifelines: Segment) -> None:
        """The threads keep the scheduling that this process has now."""
        self._lifelines = lifelines
        self._policy = (os.sched_getscheduler(0), os.sched_getparam(0))
        self.bell = EventBell.create()
        _thread.stack_size(_STACK_BYTES)

    def watch_block(self, life: Lifeline, block: int, watcher: int, stop: Stops = None, dying: int = 0) -> None:
        """Watch the process of the service that already holds this block."""
        self.watch(life, self._lifelines, block * futex.PER_BLOCK + watcher, stop, dying)

    def watch(self, life: Lifeline, segment: Segment, line: int = 0, stop: Stops = None, dying: int = 0) -> None:
        """Start a thread that waits for the death of the process that holds this line. Once per lifeline, until it is
        closed.

        `stop`: called by that thread before the bell rings; afterwards the thread sleeps so that the bytes get out.
        `dying`: the priority of the watched process. A thread that stops runs above it, if this process has real-time
        rights; otherwise, on one core, it would have to wait until the kernel has freed the dying process.
        """
        if not life.watched:
            life.watched = True
            # Without a thread, on a machine that is out of threads or memory, the late news still comes.
            with contextlib.suppress(RuntimeError, OSError):
                life.early = segment.futex("held", line)
                _thread.start_new_thread(self._wait, (life, life.early, stop, dying))

    def _wait(self, life: Lifeline, word: Futex, stop: Stops, dying: int) -> None:
        # A thread does not inherit what SCHED_RESET_ON_FORK takes away.
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
            # The thread that gets the news needs the interpreter now; the rest of this method would take its lock three
            # times.
            sleep(_QUIET_S)
        word.close()
