"""Suspend: noticing that the machine slept.

CLOCK_MONOTONIC stands still while a machine is suspended, so after it no frame and no command looks too old.
CLOCK_BOOTTIME goes on: what it has gained on the other is the time slept.
"""

from __future__ import annotations

SLEPT_NS = 50_000_000
"""Less than this is no sleep: the two clocks are read one after the other, and a process may be held up between."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


class SuspendWatch:
    """Remembers how long the machine had slept when it was asked last."""

    __slots__ = ("_gained_ns", "_read")

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
