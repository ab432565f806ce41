"""Tally: who of the fleet has confirmed a stop, and who is missing. Pure; times in seconds from the first sending."""

from __future__ import annotations

import dataclasses

from failstop.fleet import levels, message

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Set

    from failstop.fleet.levels import StopAnswer

UNCONFIRMED = {
    levels.WRITTEN: "asked, but as far as it knows not written",
    levels.ACKNOWLEDGED: "written, but its board has not acknowledged it",
    levels.OBSERVED: "written, but its IMU has not observed that the wheels have stopped",
}
"""The words for a robot that has not come to the level that confirms."""
TAKEN_OFF = "TAKEN OFF"
"""Somebody removed the robot's connection from the broker during this stop."""
WORDS = {
    message.OFFLINE: "its publisher was ended",
    message.LOST: "its connection is broken",
    TAKEN_OFF: "its connection was removed from the broker during this stop",
}
MUTE = (
    "is it switched on, does it have the fleet's key, and does the broker's access list let it read the stops? "
    "If it is gone for good: `failstop fleet forget`"
)
DOUBLED = (
    "two publishers use this name (or its publisher was restarted during the stop), so it is not known which robots "
    "have stopped: give each robot its own robot.id, restart both publishers, and stop again"
)
OLDER = "its failstop is older and can't tell a second robot of this name apart: update it"
STABLE_S = 2.0
"""A connection as old as this is one that no other client of the same name has taken over in the meantime: two that do
so alternate every second."""


@dataclasses.dataclass(frozen=True)
class Missing:
    """A robot that has not confirmed, and what is known of it."""

    robot: str
    why: str


class Tally:
    """The robots that must confirm, and those that did."""

    def __init__(self, listed: frozenset[str] | None) -> None:
        """`listed`: robots that must confirm whether the broker remembers them or not."""
        self._listed = listed or frozenset()
        self._connections: dict[str, tuple[str, str]] = {}
        """For every robot that the broker named: (the last report on its connection, whose connection that is). No
        robot is ever dropped."""
        self._answers: dict[str, dict[str, float]] = {}
        self._whys: dict[str, str] = {}
        self._confirms: dict[str, str] = {}
        """The level that confirms, by each robot's own word."""
        self._reached_it: set[str] = set()
        """Robots that have come to that level."""
        self._barred: dict[str, str] = {}
        """Robots that never count as confirmed, and why."""
        self._publishers: dict[str, set[str]] = {}
        """The numbers of all who were connected or answered by each name."""
        self._doubled: set[str] = set()
        """Robots whose publishers say that they are."""
        self._since_s: dict[str, float] = {}
        """When the connections began that were answered over."""
        self._counts: dict[str, int] = {}

    def connection(self, robot: str, word: str, publisher: str = "") -> None:
        """Take the broker's word on a robot's connection, and the number of the publisher that it is of. An empty word:
        somebody has taken it away."""
        if word:
            self._connections[robot] = word, publisher
        elif robot in self._connections:
            self._connections[robot] = TAKEN_OFF, ""
        if word == message.ONLINE:
            self._publishers.setdefault(robot, set()).add(publisher)
        self._judge(robot)

    def answer(self, answer: StopAnswer, after_s: float) -> bool:
        """Take the first of each level, and what was said last of what is wrong. True when a level is new."""
        told = self._answers.setdefault(answer.robot, {})
        new = [level for level in answer.reached if level not in told]
        for level in new:
            told[level] = after_s
            self._counts[level] = self._counts.get(level, 0) + 1
        self._whys[answer.robot] = answer.why
        self._confirms[answer.robot] = answer.confirms
        self._publishers.setdefault(answer.robot, set()).add(answer.publisher)
        self._since_s[answer.robot] = after_s - answer.connected_s
        if answer.doubled:
            self._doubled.add(answer.robot)
        if answer.confirms in told:
            self._reached_it.add(answer.robot)
        self._judge(answer.robot)
        return bool(new)

    def _judge(self, robot: str) -> None:
        """Bar a robot whose name stands for two."""
        publishers = self._publishers.get(robot, set())
        word, number = self._connections.get(robot, ("", ""))
        # The last word on its connection is of a publisher that has gone, and another one answers.
        others = word in (message.OFFLINE, message.LOST) and bool(publishers) and number not in publishers
        if len(publishers) > 1 or robot in self._doubled or others:
            self._barred[robot] = DOUBLED
        elif robot in self._answers and publishers == {""}:
            self._barred[robot] = OLDER
        else:
            self._barred.pop(robot, None)

    def reconnected(self) -> None:
        """The sender's connection is a new one: how long the broker has run is to be learned again."""
        self._since_s.clear()

    def robots(self) -> list[str]:
        """Everybody who must confirm: as listed, or seen; and whoever answered."""
        return sorted({*self._known(), *self._answers})

    def _known(self) -> Set[str]:
        return self._connections.keys() | self._listed

    def hidden(self) -> list[str]:
        """Robots that answered although the broker never named them: it names not all, then."""
        return sorted(self._answers.keys() - self._connections.keys())

    def reached(self, level: str) -> list[str]:
        """The robots that told of this level. None whose name stands for two: it is not known which of them it was."""
        return sorted(robot for robot, told in self._answers.items() if level in told and robot not in self._barred)

    def all_reached(self, level: str) -> bool:
        """Everybody did; False while nobody is known."""
        if self._counts.get(level, 0) < max(1, len(self._answers)):
            return False  # the quick way: this is asked after each answer
        robots = self.robots()
        return bool(robots) and self.reached(level) == robots

    def times_s(self, level: str) -> list[float]:
        """When they told of it, the first one first."""
        return sorted(self._answers[robot][level] for robot in self.reached(level))

    def all_confirmed(self) -> bool:
        """Every robot has confirmed the stop; False while none is known."""
        confirmed = self._reached_it
        if not confirmed or self._barred.keys() & confirmed:
            return False
        return confirmed >= self._known() and confirmed >= self._answers.keys()

    def oldest_s(self) -> float | None:
        """When the oldest connection of a robot began, as far as their answers say: the broker has run since then."""
        return min(self._since_s.values(), default=None)

    def young(self, after_s: float) -> list[str]:
        """Robots that may still take turns with another one of their name."""
        return sorted(robot for robot, since_s in self._since_s.items() if after_s - since_s < STABLE_S)

    def confirmed_by(self) -> dict[str, str]:
        """The robots that have confirmed the stop, each with the level that confirms it there."""
        return {robot: self._confirms[robot] for robot in sorted(self._reached_it - self._barred.keys())}

    def missing(self) -> list[Missing]:
        """The robots that have not confirmed it, and why, as far as is known."""
        confirmed = self._reached_it - self._barred.keys()
        return [Missing(robot, self._why(robot)) for robot in self.robots() if robot not in confirmed]

    def _why(self, robot: str) -> str:
        if barred := self._barred.get(robot):
            return barred
        told = self._answers.get(robot, {})
        if levels.WRITTEN in told:
            return UNCONFIRMED[self._confirms[robot]]
        for level in (levels.FAILED, levels.REFUSED, levels.ASKED):
            if level in told:
                why = self._whys[robot]
                return f"{level}: {why}" if why else UNCONFIRMED[levels.WRITTEN]
        connection, _ = self._connections.get(robot, ("", ""))
        if connection == message.ONLINE:
            return f"no answer, though the broker calls it connected: {MUTE}"
        if connection in WORDS:
            return f"no answer: {WORDS[connection]}"
        return "no answer, and the broker does not remember it" if robot in self._listed else "no answer"
