"""Tally: who of the fleet has confirmed a stop, and who is missing. Pure; times in seconds from the first sending."""

from __future__ import annotations

import dataclasses

from failstop.fleet import levels, vda5050

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.fleet.levels import Answer

CONFIRMED = levels.ACKNOWLEDGED
"""From this level on a robot counts as stopped: its board was in step after the stop."""
WORDS = {vda5050.OFFLINE: "its publisher was ended", vda5050.BROKEN: "its connection is broken"}

MUTE = "has it the fleet's key, and does the broker's access list let it read the stops?"


@dataclasses.dataclass(frozen=True)
class Missing:
    """A robot that has not confirmed, and what is known of it."""

    robot: str
    why: str


class Tally:
    """Who must confirm, and who did."""

    def __init__(self, expected: frozenset[str] | None) -> None:
        """`expected`: by a list of the user's; None: whoever was ever seen on the broker."""
        self._listed = expected
        self._connections: dict[str, str] = {}
        self._answers: dict[str, dict[str, float]] = {}
        self._whys: dict[str, str] = {}
        self._counts: dict[str, int] = {}

    def connection(self, robot: str, word: str) -> None:
        """What the broker keeps of a robot's connection; empty: nothing any more."""
        if word:
            self._connections[robot] = word
        else:
            self._connections.pop(robot, None)

    def answer(self, answer: Answer, after_s: float) -> None:
        """The first of each level counts, and what was said last of what is wrong."""
        told = self._answers.setdefault(answer.robot, {})
        for level in answer.reached:
            if level not in told:
                told[level] = after_s
                self._counts[level] = self._counts.get(level, 0) + 1
        self._whys[answer.robot] = answer.why

    def robots(self) -> list[str]:
        """Everybody who must confirm: as listed, or seen; and whoever answered."""
        listed = self._connections if self._listed is None else self._listed
        return sorted({*listed, *self._answers})

    def reached(self, level: str) -> list[str]:
        """Who told of this level."""
        return sorted(robot for robot, told in self._answers.items() if level in told)

    def all_reached(self, level: str) -> bool:
        """Everybody did; False while nobody is known."""
        if self._counts.get(level, 0) < max(1, len(self._answers)):
            return False  # the quick way: this is asked after each answer
        robots = self.robots()
        return bool(robots) and self.reached(level) == robots

    def times_s(self, level: str) -> list[float]:
        """When they told of it, the first one first."""
        return sorted(told[level] for told in self._answers.values() if level in told)

    def missing(self, level: str = CONFIRMED) -> list[Missing]:
        """Who did not, and why, as far as is known."""
        reached = set(self.reached(level))
        return [Missing(robot, self._why(robot)) for robot in self.robots() if robot not in reached]

    def _why(self, robot: str) -> str:
        told = self._answers.get(robot, {})
        if levels.WRITTEN in told:
            return "written, but its board has not acknowledged it"
        for level in (levels.FAILED, levels.REFUSED, levels.ASKED):
            if level in told:
                why = self._whys[robot]
                return f"{level}: {why}" if why else "asked, but not written as far as it knows"
        connection = self._connections.get(robot, "")
        if connection == vda5050.ONLINE:
            return f"no answer, though it is connected: {MUTE}"
        return f"no answer: {WORDS[connection]}" if connection in WORDS else "no answer"
