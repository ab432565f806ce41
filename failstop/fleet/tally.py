"""Tally: who of the fleet has confirmed a stop, and who is missing. Pure; times in seconds from the first sending."""

from __future__ import annotations

import dataclasses

from failstop.fleet import levels, vda5050

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Set

    from failstop.fleet.levels import StopAnswer

UNCONFIRMED = {
    levels.WRITTEN: "asked, but not written as far as it knows",
    levels.ACKNOWLEDGED: "written, but its board has not acknowledged it",
    levels.OBSERVED: "written, but its IMU has not observed that the wheels stand",
}
"""The words for a robot that has not come to the level that confirms."""
WORDS = {vda5050.OFFLINE: "its publisher was ended", vda5050.BROKEN: "its connection is broken"}

MUTE = "has it the fleet's key, and does the broker's access list let it read the stops?"


@dataclasses.dataclass(frozen=True)
class Missing:
    """A robot that has not confirmed, and what is known of it."""

    robot: str
    why: str


class Tally:
    """The robots that must confirm, and those that did."""

    def __init__(self, expected: frozenset[str] | None) -> None:
        """`expected`: by a list of the user's; None: whoever was ever seen on the broker."""
        self._listed = expected
        self._connections: dict[str, str] = {}
        self._answers: dict[str, dict[str, float]] = {}
        self._whys: dict[str, str] = {}
        self._confirms: dict[str, str] = {}
        """The level that confirms, by each robot's own word."""
        self._confirmed: set[str] = set()
        self._counts: dict[str, int] = {}

    def connection(self, robot: str, word: str) -> None:
        """Take the broker's word on a robot's connection; empty: it keeps none."""
        if word:
            self._connections[robot] = word
        else:
            self._connections.pop(robot, None)

    def answer(self, answer: StopAnswer, after_s: float) -> bool:
        """Take the first of each level, and what was said last of what is wrong. True when a level is new."""
        told = self._answers.setdefault(answer.robot, {})
        new = [level for level in answer.reached if level not in told]
        for level in new:
            told[level] = after_s
            self._counts[level] = self._counts.get(level, 0) + 1
        self._whys[answer.robot] = answer.why
        self._confirms[answer.robot] = answer.confirms
        if answer.confirms in told:
            self._confirmed.add(answer.robot)
        return bool(new)

    def robots(self) -> list[str]:
        """Everybody who must confirm: as listed, or seen; and whoever answered."""
        return sorted({*self._known(), *self._answers})

    def _known(self) -> Set[str]:
        return self._connections.keys() if self._listed is None else self._listed

    def reached(self, level: str) -> list[str]:
        """The robots that told of this level."""
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

    def all_confirmed(self) -> bool:
        """Every robot has confirmed the stop; False while none is known."""
        return bool(self._confirmed) and self._confirmed >= self._known() and self._confirmed >= self._answers.keys()

    def confirmed_by(self) -> dict[str, str]:
        """The robots that have confirmed the stop, each with the level that confirms it there."""
        return {robot: self._confirms[robot] for robot in sorted(self._confirmed)}

    def missing(self) -> list[Missing]:
        """The robots that have not confirmed it, and why, as far as is known."""
        return [Missing(robot, self._why(robot)) for robot in self.robots() if robot not in self._confirmed]

    def _why(self, robot: str) -> str:
        told = self._answers.get(robot, {})
        if levels.WRITTEN in told:
            return UNCONFIRMED[self._confirms[robot]]
        for level in (levels.FAILED, levels.REFUSED, levels.ASKED):
            if level in told:
                why = self._whys[robot]
                return f"{level}: {why}" if why else UNCONFIRMED[levels.WRITTEN]
        connection = self._connections.get(robot, "")
        if connection == vda5050.ONLINE:
            return f"no answer, though it is connected: {MUTE}"
        return f"no answer: {WORDS[connection]}" if connection in WORDS else "no answer"
