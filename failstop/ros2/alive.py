"""Alive: finds out whether the node that sent a goal is still alive. Pure: the time is an argument.

DDS (Fast DDS) lists a killed or suspended process for up to 20 s. A live process acknowledges reliable messages at
once, such as an action's feedback. So missing acknowledgements show that the sender is gone.
"""

from __future__ import annotations

DISCOVERY_NS = 1_000_000_000
"""How long it takes at most until DDS has discovered the node that sent a goal."""
LEAST_NS = 300_000_000
"""The shortest timeout. Feedback is sent every 100 ms, and one lost message must not count as a death."""


class Alive:
    """Watches the sender of one goal, starting when the goal arrives."""

    def __init__(self, now_ns: int, timeout_s: float) -> None:
        self._timeout_ns = max(round(timeout_s * 1e9), LEAST_NS)
        self._until_ns = now_ns + DISCOVERY_NS
        self._met = False
        """True after the sender was seen once."""

    def look(self, heard: int, acknowledged: bool, now_ns: int) -> str:
        """Why the sender counts as gone. Empty if it does not. `heard`: how many nodes receive the feedback reliably.
        `acknowledged`: True if each of these nodes has acknowledged everything."""
        if heard and acknowledged:
            self._until_ns, self._met = now_ns + self._timeout_ns, True
        elif not heard and self._met:
            return "nobody receives the goal any more"
        if now_ns < self._until_ns:
            return ""
        if not heard:
            return "nobody receives the goal reliably"
        return f"a node that receives the goal has acknowledged nothing for {self._timeout_ns / 1e9:g} s"


class Unwatched:
    """Watches a sender that acknowledges nothing. Only its publisher can be seen, so its path must be short."""

    def __init__(self, now_ns: int, most_s: float) -> None:
        self._begun_ns = now_ns
        self._most_s = most_s
        self._met = False

    def look(self, publishers: int, now_ns: int) -> str:
        """Why the path must end now. Empty if it may go on. `publishers`: how many publishers the topic has."""
        age_ns = now_ns - self._begun_ns
        if publishers:
            self._met = True
        elif self._met or age_ns >= DISCOVERY_NS:
            return "its publisher has gone"
        if age_ns > self._most_s * 1e9:
            return f"it takes longer than {self._most_s:g} s (arm.unwatched_s)"
        return ""
