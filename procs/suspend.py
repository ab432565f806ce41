"""Suspend: noticing that the machine slept.

CLOCK_MONOTONIC stands still while a machine is suspended, so after it no frame and no command looks too old.
CLOCK_BOOTTIME goes on: what it has gained on the other is the time slept.
"""

from __future__ import annotations

from time import CLOCK_BOOTTIME, clock_gettime_ns, monotonic_ns

SLEPT_NS = 50_000_000
"""Less than this is no sleep: the two clocks are read one after the other, and a process may be held up between."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


def gained_ns() -> int:
    """How far CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, in ns: all the time slept since the machine started."""
    before_ns = monotonic_ns()
    boot_ns = clock_gettime_ns(CLOCK_BOOTTIME)
    # The later reading, so that being held up in between makes the result too small and never looks like a sleep.
    return boot_ns - max(before_ns, monotonic_ns())


class SuspendWatch:
    """Remembers how long the machine had slept when it was asked last."""

    __slots__ = ("_gained_ns", "_read")

    def __init__(self, read: Callable[[], int] = gained_ns) -> None:
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
