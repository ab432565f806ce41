"""Stamps: finds out how old messages are by their stamps, and which nodes' clocks disagree with this computer's.
Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from failstop.api.words import DAY_S, span

TOLD_NS = 2_000_000_000
"""How long a disagreement is reported after the last message that showed it."""
NO_CLOCK = "use_sim_time is true, and nobody publishes /clock, so ROS has no time here"
AGREE = "do the clocks agree?"
OTHER_CLOCK = "is use_sim_time the same in both nodes?"
"""The advice if stamps are days apart. One node then uses a simulator's time, which counts from 0, and the other uses
the time since 1970."""


class Trouble(NamedTuple):
    """A problem with one topic's stamps. `seen_ns`: when it was last seen."""

    who: str
    text: str
    age_s: float
    seen_ns: int


class Stamps:
    """Judges messages by their stamps, and remembers the problems of each topic."""

    def __init__(self, ros_ns: Callable[[], int]) -> None:
        """`ros_ns` returns ROS's present time, ns, which may be a simulator's. 0 if ROS has no time."""
        self._ros_ns = ros_ns
        self._troubles: dict[str, Trouble] = {}

    def late(self, topic: str, who: str, stamp: Any, most_s: float, now_ns: int) -> str:
        """Why a message is refused because of its stamp, or "". `stamp`: a builtin_interfaces/Time. A zero stamp counts
        as now. `most_s`: the highest allowed age. Without a ROS time, every other stamp is refused. A stamp from the
        future is only remembered as a problem."""
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if not stamp_ns:
            return ""
        if not (ros_ns := self._ros_ns()):
            return f"nobody knows how old its stamp is: {NO_CLOCK}"
        age_s = (ros_ns - stamp_ns) / 1e9
        if abs(age_s) <= most_s:
            return ""
        self._note(topic, who, age_s, now_ns)
        if age_s >= DAY_S:
            return f"its stamp is {span(age_s)} old (most: {most_s:g} s); {OTHER_CLOCK}"
        return f"its stamp is {age_s:.3f} s old (most: {most_s:g} s); {AGREE}" if age_s > 0 else ""

    def _note(self, topic: str, who: str, age_s: float, now_ns: int) -> None:
        """Remember a problem. Small changes of the age don't change its text, because each new text is logged as an
        event."""
        before = self._troubles.get(topic)
        fresh = before and before.who == who and now_ns - before.seen_ns <= TOLD_NS
        if before and fresh and abs(age_s - before.age_s) < 0.1 + abs(before.age_s) / 4:
            self._troubles[topic] = before._replace(seen_ns=now_ns)
            return
        apart = span(abs(age_s)) if abs(age_s) >= DAY_S else f"{abs(age_s):.1f} s"
        how = f"{apart} old, and refused" if age_s > 0 else f"{apart} in the future"
        why = OTHER_CLOCK if abs(age_s) >= DAY_S else AGREE
        text = f"{who} publishes {topic} with stamps that are {how}: {why}"
        self._troubles[topic] = Trouble(who, text, age_s, now_ns)

    def wrong(self, now_ns: int) -> list[str]:
        """The present problems, one line for each."""
        fresh = [row.text for row in self._troubles.values() if now_ns - row.seen_ns <= TOLD_NS]
        return fresh if self._ros_ns() else [NO_CLOCK, *fresh]
