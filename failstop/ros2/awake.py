"""Awake: how long a request or a goal may have waited because this node did not run.

ROS does not say when a service request was received, and a message may wait in the kernel before DDS receives it. So
after a pause of the node, everything that is handled at first may be as old as the pause.
"""

from __future__ import annotations

from collections.abc import Callable
from time import CLOCK_BOOTTIME, clock_gettime_ns

from failstop.api.errors import Refused
from failstop.ros2 import words
from failstop.ros2.commanders import FRESH_NS
from failstop.ros2.link import ANSWER_S


def boot_ns() -> int:
    """The time since the boot, which goes on while the computer sleeps."""
    return clock_gettime_ns(CLOCK_BOOTTIME)


class Awake:
    """Notes the pauses of the thread that spins the node."""

    def __init__(self, clock: Callable[[], int] = boot_ns) -> None:
        self._clock = clock
        self._turned_ns = clock()
        self._away_ns = 0
        """How long the last pause was."""
        self._until_ns = 0
        """What arrived before this time may have waited as long as the last pause."""

    def waited_ns(self, waited_ns: int = 0) -> int:
        """The longest that what is handled now may have waited. Call this also at every turn of the thread.
        `waited_ns`: the time that it is known to have waited."""
        now_ns = self._clock()
        away_ns, self._turned_ns = now_ns - self._turned_ns, now_ns
        if away_ns > FRESH_NS:
            # Soon after a long pause, the thread may be held up again before it has handled everything.
            self._away_ns = max(away_ns, self._away_ns if now_ns - away_ns < self._until_ns else 0)
            self._until_ns = now_ns + FRESH_NS
        return max(waited_ns, self._away_ns) if now_ns - waited_ns < self._until_ns else waited_ns

    def check_request(self) -> None:
        """Check the service request that is handled now. Raises Refused if it may have waited for so long that its
        caller no longer waits for the answer."""
        waited_ns = self.waited_ns()
        if waited_ns > ANSWER_S * 1e9:
            raise Refused(words.ask_again(waited_ns / 1e9))
