"""The opener: a thread of the supervisor's that opens a lost port when it is back, and writes the burst on it.

An open may take seconds, of a board that is slow to wake up: it holds nobody up here. The burst does not wait for the
supervisor's loop either; what follows from it does.
"""

from __future__ import annotations

# The C module under `signal`, which costs an import of enum.
import _signal
import _thread
import os

from failstop.board.stop_port import StopPort

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.finder import Finder
    from failstop.procs.world import World
    from failstop.shm.bell import EventBell

LOOK_NS = 5_000_000
"""How often a lost port is looked for."""


class Opener:
    """`finder` is the thread's from look() until take() has returned something, and the supervisor's loop's else."""

    __slots__ = ("_asked", "_bell", "_found", "_now_ns", "_sleep", "_spare", "finder")

    def __init__(self, world: World, finder: Finder, bell: EventBell) -> None:
        """`bell` rings when the port is open."""
        self._now_ns, self._sleep = world.now_ns, world.sleep
        self.finder = finder
        self._bell = bell
        self._asked = _thread.allocate_lock()
        self._asked.acquire()
        self._found: tuple[int, int] | None = None
        self._spare = -1
        self._reserve()

    def begin(self) -> None:
        """Start the thread, which lives as long as the process: at a loss there may be none to be had."""
        _thread.start_new_thread(self._live, (os.sched_getscheduler(0), os.sched_getparam(0)))

    def look(self) -> None:
        """The port was lost: open it when it is back."""
        self._asked.release()

    def take(self) -> tuple[int, int] | None:
        """The opened port, once: its descriptor, and when the burst on it was written (0: it was not)."""
        found, self._found = self._found, None
        return found

    def attempt(self) -> bool:
        """One look. A descriptor number was kept for it: those that are free now may be gone by then."""
        if self._spare >= 0:
            os.close(self._spare)
        fd = self.finder.open(self._now_ns())
        if fd >= 0:
            written = StopPort(fd).burst()
            self._found = (fd, self._now_ns() if written else 0)
            self._bell.ring()
        self._reserve()
        return fd >= 0

    def _reserve(self) -> None:
        try:
            self._spare = os.dup(self._bell.fd)
        except OSError:
            self._spare = -1

    def _live(self, policy: int, priority: os.sched_param) -> None:
        _signal.pthread_sigmask(_signal.SIG_BLOCK, _signal.valid_signals())  # they are for the loop
        # A thread does not inherit what SCHED_RESET_ON_FORK takes away.
        os.sched_setscheduler(0, policy, priority)
        while True:
            self._asked.acquire()
            while not self.attempt():
                self._sleep(LOOK_NS / 1e9)
