"""Suspend: notices that the machine has slept. CLOCK_MONOTONIC does not go on during a sleep, so frames from before it
don't look too old."""

from __future__ import annotations

import time

SLEPT_NS = 50_000_000
"""A shorter time does not count as a sleep of the machine, because the two clocks are read one after the other and this
process may be held up in between."""


def gained_ns() -> int:
    """How far CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, ns, which is how long the machine has slept since it
    started."""
    before_ns = time.monotonic_ns()
    boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    # Read it second, so that being held up in between makes the result too small and never looks like a sleep.
    return boot_ns - max(before_ns, time.monotonic_ns())


class SuspendWatch:
    """Remembers how long the machine had slept at the last call."""

    def __init__(self) -> None:
        # A reading that was held up is too small, so take the best of three.
        self._gained_ns = max(gained_ns() for _ in range(3))

    def slept_ns(self) -> int:
        """How long the machine has slept since the last call, ns; 0 if it has not."""
        before_ns, now_ns = self._gained_ns, gained_ns()
        self._gained_ns = max(before_ns, now_ns)
        return now_ns - before_ns if now_ns - before_ns >= SLEPT_NS else 0
