"""Tally: which robots have confirmed a fleet stop, and which are missing. Pure; times are counted from the first
sending, s."""

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
"""Somebody removed the robot's connection from the broker while the stop was sent."""
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
"""A connection of this age, s, is certainly not one of two clients that use the same name, because two such clients
take the connection from each other every second."""


@dataclasses.dataclass(frozen=True)
class Missing:
    """A robot that has not confirmed, and what is known about it."""

    robot: str
    why: str


class Tally:
    """The robots that must confirm a stop, and the answers of each."""

    def __init__(self, listed: frozenset[str] | None) -> None:
        """`listed`: robots that must confirm even if the broker does not remember them."""
        self._listed = listed or frozenset()
        self._connections: dict[str, tuple[str, str]] = {}
        """For every robot that the broker has named: (the last report about its connection, the number of the publisher
        that has it). No robot is ever removed."""
        self._answers: dict[str, dict[str, float]] = {}
        self._whys: dict[str, str] = {}
        self._confirms: dict[str, str] = {}
        """The level that confirms a stop, as each robot has reported it."""
        self._reached_it: set[str] = set()
        """Robots that have reached that level."""
        self._barred: dict[str, str] = {}
        """Robots that never count as confirmed, each with the reason."""
        self._publishers: dict[str, set[str]] = {}
        """For each name, the numbers of all publishers that were connected or answered."""
        self._doubled: set[str] = set()
        """Robots whose publishers report that another one uses the same name."""
        self._since_s: dict[str, float] = {}
        """When the connections began through which the robots answered."""
        self._counts: dict[str, int] = {}

    def connection(self, robot: str, word: str, publisher: str = "") -> None:
        """Take in the broker's report about a robot's connection, and the number of its publisher. An empty word means
        that somebody has removed the report."""
        if word:
            self._connections[robot] = word, publisher
        elif robot in self._connections:
            self._connections[robot] = TAKEN_OFF, ""
        if word == message.ONLINE:
            self._publishers.setdefault(robot, set()).add(publisher)
        self._judge(robot)

    def answer(self, answer: StopAnswer, after_s: float) -> bool:
        """Take in a robot's answer: the first time of each level, and the newest report of what is wrong. True if it
        brought a new level."""
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
        """Bar a robot if two publishers use its name."""
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
        """The sender has a new connection, so how long the broker has been running must be found out again."""
        self._since_s.clear()

    def robots(self) -> list[str]:
        """All robots that must confirm: those in the file, those that the broker has named, and those that have
        answered."""
        return sorted({*self._known(), *self._answers})

    def _known(self) -> Set[str]:
        return self._connections.keys() | self._listed

    def hidden(self) -> list[str]:
        """Robots that have answered although the broker never named them. So the broker does not name all."""
        return sorted(self._answers.keys() - self._connections.keys())

    def reached(self, level: str) -> list[str]:
        """The robots that have reported this level. Robots with two publishers are left out, because nobody knows which
        of the two answered."""
        return sorted(robot for robot, told in self._answers.items() if level in told and robot not in self._barred)

    def all_reached(self, level: str) -> bool:
        """True if every robot has reported this level; False if no robot is known."""
        if self._counts.get(level, 0) < max(1, len(self._answers)):
            return False  # the quick way: this is asked after each answer
        robots = self.robots()
        return bool(robots) and self.reached(level) == robots

    def times_s(self, level: str) -> list[float]:
        """When the robots reported this level, the earliest first."""
        return sorted(self._answers[robot][level] for robot in self.reached(level))

    def all_confirmed(self) -> bool:
        """True if every robot has confirmed the stop; False if no robot is known."""
        confirmed = self._reached_it
        if not confirmed or self._barred.keys() & confirmed:
            return False
        return confirmed >= self._known() and confirmed >= self._answers.keys()

    def oldest_s(self) -> float | None:
        """When the oldest connection of a robot began, according to the answers; the broker has been running since
        then."""
        return min(self._since_s.values(), default=None)

    def young(self, after_s: float) -> list[str]:
        """Robots whose connection is so young that another robot of the same name may be taking turns with it."""
        return sorted(robot for robot, since_s in self._since_s.items() if after_s - since_s < STABLE_S)

    def confirmed_by(self) -> dict[str, str]:
        """The robots that have confirmed the stop, each with the level that confirms it there."""
        return {robot: self._confirms[robot] for robot in sorted(self._reached_it - self._barred.keys())}

    def missing(self) -> list[Missing]:
        """The robots that have not confirmed the stop, each with the reason, if it is known."""
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
