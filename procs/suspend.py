"""Suspend: notices that the machine has slept. CLOCK_MONOTONIC stops during a sleep, so frames that were made
before the sleep look younger than they are."""

from __future__ import annotations

import time

SLEPT_NS = 50_000_000
"""The shortest time that counts as a sleep of the machine. The two clocks are read one after the other, and this
process may be held up between the readings."""


def gained_ns() -> int:
    """Return how far CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, ns. This is how long the machine has slept since it
    was started."""
    before_ns = time.monotonic_ns()
    boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    # Read CLOCK_MONOTONIC again. If this process is held up between the readings, the result is too small, so the delay
    # never looks like a sleep.
    return boot_ns - max(before_ns, time.monotonic_ns())


class SuspendWatch:
    """Notices each sleep of the machine, by comparing the two clocks at each call of slept_ns()."""

    def __init__(self) -> None:
        # A delay between the readings makes a result too small, so take the largest of three.
        self._gained_ns = max(gained_ns() for _ in range(3))

    def slept_ns(self) -> int:
        """Return how long the machine has slept since the last call, ns. 0 if it has not slept."""
        before_ns, now_ns = self._gained_ns, gained_ns()
        self._gained_ns = max(before_ns, now_ns)
        return now_ns - before_ns if now_ns - before_ns >= SLEPT_NS else 0
