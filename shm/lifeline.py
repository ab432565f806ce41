"""Lifelines: the news of a process's death, in the same poll as everything else.

Early, from a robust futex that the process holds (futex.py): a thread blocks on it, marks the lifeline as dead and
rings a bell. Late, from a pidfd, which nothing in the watched process can hold back and no reused pid can confuse.
Either is enough. Heartbeats are for what neither sees: hangs.
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
"""With the flag that the processes have (procs/rights.py): only CAP_SYS_NICE may clear it."""
_STACK_BYTES = 128 * 1024
_QUIET_S = 0.02
_WAY_S = 30e-6


def give_way() -> None:
    """Sleep for a moment, after a stop was written. Bytes for a pty, or for a driver that hands them to a kernel
    thread, are carried by one of lower priority, which may be waiting for this core."""
    sleep(_WAY_S)


def pid_namespace() -> int:
    """The namespace of this process's pid: in another one the number is nobody's, or somebody else's. 0: not known."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return 0


class Lifeline:
    """Watches one process. `fd` becomes readable when the process has died; it then stays readable."""

    def __init__(self, pid: int = 0) -> None:
        """0: a process whose number is not known here, as in a container: the early news alone can tell. Raises
        ProcessLookupError when there is no such process."""
        self.pid = pid
        self.fd = os.pidfd_open(pid) if pid else os.eventfd(0, os.EFD_CLOEXEC)
        self.watched = False
        self.early: Futex | None = None
        """Once it is watched: where a thread waits for the early news."""
        self.marked = False
        """The early news has come."""

    def died(self, ready: dict[int, int]) -> bool:
        """True when this wake-up, or the early news before it, says that the process has died."""
        return self.marked or self.fd in ready

    def dead(self) -> bool:
        """True once the process has died, and from before anyone who dies with it. Two system calls; never blocks."""
        return self.marked or (self.early is not None and self.early.told()) or self.wait(0)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the process has ended; False: it has not within `timeout_s`."""
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))

    def kill(self) -> None:
        """SIGKILL the process; never another one that has its pid by now."""
        with contextlib.suppress(OSError):
            _signal.pidfd_send_signal(self.fd, _SIGKILL)

    def demote(self) -> None:
        """Take real-time rights from every thread of the dying process; call when the stop is out.

        Its memory takes the kernel half a millisecond and more to tear down, and at real-time priority that keeps a
        core from the kernel's own workers, one of which may be carrying the stop.
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
    """One process's waiting threads; `bell` rings after a lifeline has told of a death."""

    def __init__(self, lifelines: Segment) -> None:
        """Threads take the scheduling that this process has now."""
        self._lifelines = lifelines
        self._policy = (os.sched_getscheduler(0), os.sched_getparam(0))
        self.bell = EventBell.create()
        _thread.stack_size(_STACK_BYTES)

    def watch_block(self, life: Lifeline, block: int, watcher: int, stop: Stops = None, dying: int = 0) -> None:
        """Wait for the death of the process of the service that holds this block already."""
        self.watch(life, self._lifelines, block * futex.PER_BLOCK + watcher, stop, dying)

    def watch(self, life: Lifeline, segment: Segment, line: int = 0, stop: Stops = None, dying: int = 0) -> None:
        """Wait in a thread of its own for the death of who holds this line. Once a lifeline; until it is closed.
        `stop`: what that thread does before the bell rings; then it makes way for the bytes. `dying`: the priority of
        who holds the line. A thread that stops runs above it, where its process has real-time rights: on one core it
        would wait until the kernel has taken the dying down."""
        if not life.watched:
            life.watched = True
            # A machine that is out of threads or memory still has the late news.
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
            # The thread that hears it needs the interpreter now, whose lock the rest of this one would take thrice.
            sleep(_QUIET_S)
        word.close()
