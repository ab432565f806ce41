"""World: the clocks of the machine that a process runs on, and its ways to wait.

Every shell is handed one and asks no other clock. A test hands in one whose clock it moves. The fields are functions,
so that who needs one often keeps it, and asks as fast as it would without a World.
"""

from __future__ import annotations

import select
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


def gained_ns(
    now_ns: Callable[[], int] = time.monotonic_ns, clock_ns: Callable[[int], int] = time.clock_gettime_ns
) -> int:
    """How far CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, in ns: all the time slept since the machine started."""
    before_ns = now_ns()
    boot_ns = clock_ns(time.CLOCK_BOOTTIME)
    # The later reading, so that being held up in between makes the result too small and never looks like a sleep.
    return boot_ns - max(before_ns, now_ns())


class World:
    """The real one, but for what is given."""

    __slots__ = ("epoll", "gained_ns", "now_ns", "select", "sleep", "unix_s")

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
