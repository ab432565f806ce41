"""Lifelines report the death of a process through a descriptor, so a loop can wait for it along with its other
descriptors.

Each death is reported twice, and one report is enough. The early report comes from a robust futex that the process
holds (futex.py). A thread waits for it, marks the lifeline as dead and rings a bell. The late report comes from a
pidfd. The watched process can't prevent the late report, and another process with the same pid can't cause it. A hang
shows only in the heartbeat (heartbeat.py).
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
"""The scheduling policy of a demoted process. failstop's processes have the flag SCHED_RESET_ON_FORK (procs/rights.py).
The policy keeps this flag, because only a process with CAP_SYS_NICE may clear it."""
_STACK_BYTES = 128 * 1024
_QUIET_S = 0.02
_WAY_S = 30e-6


def give_way() -> None:
    """Sleep for a moment after a stop was written, so that its bytes leave the computer. With a pty and some drivers, a
    kernel thread of lower priority sends the bytes, and it may need this processor core."""
    sleep(_WAY_S)


def pid_namespace() -> int:
    """The inode of this process's pid namespace, or 0 if it is not known. In a different namespace, the same pid is
    another process or no process."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return 0


class Lifeline:
    """Watches one process for death. `fd` becomes readable when the process has died, and stays readable."""

    def __init__(self, pid: int = 0) -> None:
        """`pid`: the process to watch, or 0 if its pid is not known in this namespace, for example because it runs in a
        container. With 0, only the early report can come. Raises ProcessLookupError if no such process exists."""
        self.pid = pid
        self.fd = os.pidfd_open(pid) if pid else os.eventfd(0, os.EFD_CLOEXEC)
        self.watched = False
        self.early: Futex | None = None
        """The futex on which a thread waits for the early report. None if no thread waits."""
        self.marked = False
        """True once the early report has come."""

    def died(self, ready: dict[int, int]) -> bool:
        """True if the early report of the death has come, or if `fd` is ready. `ready`: the descriptors that have just
        woken the loop."""
        return self.marked or self.fd in ready

    def dead(self) -> bool:
        """True if the watched process has died, even if no report has reached the loop yet. Makes two system calls and
        never blocks."""
        return self.marked or (self.early is not None and self.early.owner_died()) or self.wait(0)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the process has ended. Returns False if it has not ended within `timeout_s`."""
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))

    def kill(self) -> None:
        """Send SIGKILL to the watched process, and never to a different process with the same pid."""
        with contextlib.suppress(OSError):
            _signal.pidfd_send_signal(self.fd, _SIGKILL)

    def demote(self) -> None:
        """Take real-time priority from every thread of the dying process. Call this after the stop was written.

        The kernel needs half a millisecond or more to free the process's memory. At real-time priority, this would hold
        up other kernel threads on the same core, and one of them may be sending the stop's bytes.
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
    """The threads of this process that wait for early reports of deaths. `bell` rings after a thread has marked a
    lifeline as dead."""

    def __init__(self, lifelines: Segment) -> None:
        """The threads get the scheduling policy and priority that this process has now."""
        self._lifelines = lifelines
        self._policy = (os.sched_getscheduler(0), os.sched_getparam(0))
        self.bell = EventBell.create()
        _thread.stack_size(_STACK_BYTES)

    def watch_block(self, life: Lifeline, block: int, watcher: int, stop: Stops = None, dying: int = 0) -> None:
        """Watch a process of the service that already holds a block of futexes. `block`: the number of the block.
        `watcher`: which line of the block this process watches. `stop` and `dying`: see watch()."""
        self.watch(life, self._lifelines, block * futex.PER_BLOCK + watcher, stop, dying)

    def watch(self, life: Lifeline, segment: Segment, line: int = 0, stop: Stops = None, dying: int = 0) -> None:
        """Start a thread that waits for the death of the process that holds the futex line `line`. Each lifeline gets
        only one thread, which ends when the lifeline is closed.

        `stop`: the thread calls this when the process has died. Then the thread demotes the dying process, calls
        give_way() and rings the bell. `dying`: the priority of the watched process. If the calling process has
        real-time rights, a thread with a `stop` gets a priority above `dying`. Without this priority, on a single core,
        the thread would wait until the kernel has freed the dying process's memory.
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
