"""World: the machine that a process runs on: its clocks, its ways to wait, its other processes, what a port holds.

Every shell is handed one and asks no other. A test hands in one whose clock it moves, or whose processes it plays. The
fields are functions, so that who needs one often keeps it, and asks as fast as it would without a World.
"""

from __future__ import annotations

import os
import select
import time

from failstop.board import port
from failstop.procs import starved
from failstop.shm.lifeline import EarlyNews, Lifeline

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


def gained_ns(
    now_ns: Callable[[], int] = time.monotonic_ns, clock_ns: Callable[[int], int] = time.clock_gettime_ns
) -> int:
    """How far CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, in ns: all the time slept since the machine started."""
    before_ns = now_ns()
    boot_ns = clock_ns(time.CLOCK_BOOTTIME)
    # The later reading, so that being held up in between makes the result too small and never looks like a sleep.
    return boot_ns - max(before_ns, now_ns())


SLEPT_NS = 50_000_000
"""Less than this is no sleep: the two clocks are read one after the other, and a process may be held up between."""


class SuspendWatch:
    """Notices that the machine slept, after which no frame and no command looks too old: CLOCK_MONOTONIC stood still.
    Remembers how long it had slept when it was asked last."""

    def __init__(self, read: Callable[[], int]) -> None:
        """`read`: a World's gained_ns."""
        self._read = read
        # A reading that was held up is too small: the best of three.
        self._gained_ns = max(read() for _ in range(3))

    def slept_ns(self) -> int:
        """The time slept since the last call, in ns; 0 when there was no sleep."""
        now_ns = self._read()
        slept_ns = now_ns - self._gained_ns
        if slept_ns < SLEPT_NS:
            # A reading that was held up is too small: the best one so far is the truth.
            self._gained_ns = max(self._gained_ns, now_ns)
            return 0
        self._gained_ns = now_ns
        return slept_ns


def spawn(arguments: list[str], environ: Mapping[str, str], passed: Sequence[int] = ()) -> int:
    """Start a process that inherits the descriptors in `passed`; returns its pid. Raises OSError."""
    for fd in passed:
        os.set_inheritable(fd, True)
    try:
        # A terminal's signals (Ctrl-C, Ctrl-Z, quit, its hang-up) go to a whole process group: were the children in
        # it, they would all die or freeze at once, with nobody left to stop the wheels.
        return os.posix_spawn(arguments[0], arguments, environ, setsid=True, setsigmask=())
    finally:
        for fd in passed:
            os.set_inheritable(fd, False)


def reap(pid: int, options: int = os.WNOHANG) -> int | None:
    """The exit code of a child that has ended, negative the signal that killed it; None: it can't be collected yet."""
    found, status = os.waitpid(pid, options)
    return os.waitstatus_to_exitcode(status) if found else None


def continued() -> bool:
    """True when a signal has let this process go on since the last call, which takes SIGCONT to be blocked."""
    import signal  # the supervisor, which alone asks, has it; the others stay small without

    return signal.sigtimedwait((signal.SIGCONT,), 0) is not None


class World:
    """The real one, but for what is given."""

    def __init__(
        self,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        unix_s: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.now_ns = now_ns
        """CLOCK_MONOTONIC."""
        self.unix_s = unix_s
        """The time of day, for what people read."""
        self.gained_ns: Callable[[], int] = gained_ns
        """The time that the machine has slept."""
        self.sleep = sleep
        self.select = select.select
        self.epoll = select.epoll
        self.spawn = spawn
        self.reap = reap
        self.kill = os.kill
        self.lifeline = Lifeline
        """The news of a process's death, by its pid."""
        self.early_news = EarlyNews
        """The same by what it holds, in threads of their own."""
        self.starved = starved.look
        """Whether the machine did not run a silent process."""
        self.continued = continued
        self.unsent_bytes = port.unsent_bytes
        """What the kernel has taken for a port, and not passed on."""
