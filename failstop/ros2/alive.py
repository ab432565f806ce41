"""Alive: whether the node that has sent a goal is seen to live. Pure: the time is an argument.

DDS counts a killed process for up to 20 s (Fast DDS), and a stopped one for as long. What a living process does at
once is to acknowledge what it is sent reliably; a client of an action is sent feedback.
"""

from __future__ import annotations

DISCOVERY_NS = 1_000_000_000
"""By then the ends of a node that has sent a goal are known here."""
LEAST_NS = 300_000_000
"""Feedback is sent each 100 ms, and what is lost once is no death."""


class Alive:
    """One sender, from when its goal came."""

    def __init__(self, now_ns: int, timeout_s: float) -> None:
        self._timeout_ns = max(round(timeout_s * 1e9), LEAST_NS)
        self._until_ns = now_ns + DISCOVERY_NS
        self._met = False
        """It was seen at least once."""

    def look(self, heard: int, acknowledged: bool, now_ns: int) -> str:
        """Why the sender counts as gone; empty: it does not. `heard`: how many nodes hear reliably what it should hear;
        `acknowledged`: each of them has acknowledged all that it was sent."""
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
    """A sender of which only its publisher is known: how long its path may take, and whether the publisher is there."""

    def __init__(self, now_ns: int, most_s: float) -> None:
        self._begun_ns = now_ns
        self._most_s = most_s
        self._met = False

    def look(self, publishers: int, now_ns: int) -> str:
        """Why its path is to end now; empty: it goes on."""
        age_ns = now_ns - self._begun_ns
        if publishers:
            self._met = True
        elif self._met or age_ns >= DISCOVERY_NS:
            return "its publisher has gone"
        if age_ns > self._most_s * 1e9:
            return f"it takes longer than {self._most_s:g} s (arm.unwatched_s)"
        return ""
