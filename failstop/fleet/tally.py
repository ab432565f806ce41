"""Tally: counts which robots have confirmed a fleet stop, and which are missing. Pure. All times are in s since the
stop was first sent."""

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
    levels.OBSERVED: "written, but it has not observed that its wheels have stopped",
}
"""For each level that can confirm a stop, the text about a robot that has not reached it."""
TAKEN_OFF = "TAKEN OFF"
"""Marks the connection of a robot whose stored message was removed from the broker during the stop."""
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
"""How old a robot's connection must be to prove that no second client uses the same client name, s. Two such clients
would end each other's connection every second."""


@dataclasses.dataclass(frozen=True)
class Missing:
    """A robot that has not confirmed the stop, and what is known about the reason."""

    robot: str
    why: str


class Tally:
    """Counts which robots have confirmed a fleet stop."""

    def __init__(self, listed: frozenset[str] | None) -> None:
        """`listed`: robots that must confirm even if the broker does not know them."""
        self._listed = listed or frozenset()
        self._connections: dict[str, tuple[str, str]] = {}
        """For every robot that the broker has named, the newest state of its connection, and the number of the
        publisher that has reported this state. A robot stays in the dict even if its message is removed from the
        broker."""
        self._answers: dict[str, dict[str, float]] = {}
        """For each robot, the levels in its newest answer. The value of a level is the time at which the robot first
        reported it, since when every answer has had it."""
        self._whys: dict[str, str] = {}
        self._confirms: dict[str, str] = {}
        """For each robot, the level that confirms its stop, as the robot has reported it."""
        self._observes: set[str] = set()
        """Robots that have observed, or may still observe, that their wheels have come to rest."""
        self._reached_it: set[str] = set()
        """Robots whose newest answer has the level that confirms their stop, and nothing that contradicts it."""
        self._barred: dict[str, str] = {}
        """Robots that can't count as confirmed, each with the reason."""
        self._publishers: dict[str, set[str]] = {}
        """For each robot's name, the numbers of all publishers that were connected or have answered."""
        self._doubled: set[str] = set()
        """Robots whose publishers report that another publisher uses the same name."""
        self._since_s: dict[str, float] = {}
        """When each robot's connection to the broker began, computed from the robot's newest answer."""

    def connection(self, robot: str, word: str, publisher: str = "") -> None:
        """Note a robot's connection, as the broker reports it. `publisher`: the number of the robot's publisher. An
        empty `word` means that somebody has removed the stored message."""
        if word:
            self._connections[robot] = word, publisher
        elif robot in self._connections:
            self._connections[robot] = TAKEN_OFF, ""
        if word == message.ONLINE:
            self._publishers.setdefault(robot, set()).add(publisher)
        self._judge(robot)

    def answer(self, answer: StopAnswer, after_s: float) -> bool:
        """Note a robot's answer, which arrived at `after_s`. Returns True if it has a level that is new for this
        robot. Only the robot's newest answer counts, because the robot may see its wheels turn after it has
        confirmed."""
        told = self._answers.get(answer.robot, {})
        new = [level for level in answer.reached if level not in told]
        self._answers[answer.robot] = {level: told.get(level, after_s) for level in answer.reached}
        self._whys[answer.robot] = answer.why
        self._confirms[answer.robot] = answer.confirms
        self._publishers.setdefault(answer.robot, set()).add(answer.publisher)
        self._since_s[answer.robot] = after_s - answer.connected_s
        if answer.doubled:
            self._doubled.add(answer.robot)
        for robots, so in (
            (self._observes, answer.observes),
            (self._reached_it, answer.confirms in answer.reached and not answer.why),
        ):
            (robots.add if so else robots.discard)(answer.robot)
        self._judge(answer.robot)
        return bool(new)

    def _judge(self, robot: str) -> None:
        """Decide whether a robot can count as confirmed. It can't if two publishers use its name, or if its failstop is
        too old to notice a second publisher."""
        publishers = self._publishers.get(robot, set())
        word, number = self._connections.get(robot, ("", ""))
        # One publisher's connection has ended, but another publisher answers.
        others = word in (message.OFFLINE, message.LOST) and bool(publishers) and number not in publishers
        if len(publishers) > 1 or robot in self._doubled or others:
            self._barred[robot] = DOUBLED
        elif robot in self._answers and publishers == {""}:
            self._barred[robot] = OLDER
        else:
            self._barred.pop(robot, None)

    def reconnected(self) -> None:
        """Forget how long the robots have been connected. Call this when the sender has a new connection, because the
        broker may have restarted."""
        self._since_s.clear()

    def robots(self) -> list[str]:
        """Return all robots that must confirm the stop. They are the robots in the file stop.robots_file, the robots
        that the broker has named, and the robots that have answered."""
        return sorted({*self._known(), *self._answers})

    def _known(self) -> Set[str]:
        return self._connections.keys() | self._listed

    def hidden(self) -> list[str]:
        """Return the robots that have answered although the broker never named them. The broker may then hide more
        robots."""
        return sorted(self._answers.keys() - self._connections.keys())

    def reached(self, level: str) -> list[str]:
        """Return the robots that have reported this level. Robots that can't count as confirmed are left out (see
        _judge())."""
        return sorted(robot for robot, told in self._answers.items() if level in told and robot not in self._barred)

    def unobserved(self) -> list[str]:
        """Return the robots that have confirmed the stop and can observe their wheels, but have not observed that they
        are still."""
        observed = {robot for robot, told in self._answers.items() if levels.OBSERVED in told}
        return sorted((self._reached_it & self._observes) - self._barred.keys() - observed)

    def unnamed(self) -> list[str]:
        """Return the robots in the file stop.robots_file that the broker never named. The broker may hide them."""
        return sorted(self._listed - self._connections.keys())

    def times_s(self, level: str) -> list[float]:
        """Return the times at which robots reported this level, the earliest first."""
        return sorted(self._answers[robot][level] for robot in self.reached(level))

    def all_confirmed(self) -> bool:
        """Return True if every robot has confirmed the stop. False if no robot is known."""
        confirmed = self._reached_it
        if not confirmed or self._barred.keys() & confirmed:
            return False
        return confirmed >= self._known() and confirmed >= self._answers.keys()

    def oldest_s(self) -> float | None:
        """Return when the oldest connection between a robot and the broker began, according to the robots' answers. The
        broker has been running at least since then. None if no robot has answered since reconnected()."""
        return min(self._since_s.values(), default=None)

    def young(self, after_s: float) -> list[str]:
        """Return the robots whose connections to the broker are younger than STABLE_S at `after_s`, computed from the
        robots' newest answers. Such a connection may break again at once, for example if another client of the same
        client name ends it again and again."""
        return sorted(robot for robot, since_s in self._since_s.items() if after_s - since_s < STABLE_S)

    def confirmed_by(self) -> dict[str, str]:
        """Return the robots that have confirmed the stop, each with the level that confirmed it."""
        return {robot: self._confirms[robot] for robot in sorted(self._reached_it - self._barred.keys())}

    def missing(self) -> list[Missing]:
        """Return the robots that have not confirmed the stop, each with the reason as far as it is known."""
        confirmed = self._reached_it - self._barred.keys()
        return [Missing(robot, self._why(robot)) for robot in self.robots() if robot not in confirmed]

    def _why(self, robot: str) -> str:
        if barred := self._barred.get(robot):
            return barred
        told, why = self._answers.get(robot, {}), self._whys.get(robot, "")
        if proofs := [level for level in levels.PROOFS if level in told]:
            return f"{proofs[-1]}, but: {why}" if why else UNCONFIRMED[self._confirms[robot]]
        for level in (levels.FAILED, levels.REFUSED, levels.ASKED):
            if level in told:
                return f"{level}: {why}" if why else UNCONFIRMED[levels.WRITTEN]
        connection, _ = self._connections.get(robot, ("", ""))
        if connection == message.ONLINE:
            return f"no answer, though the broker calls it connected: {MUTE}"
        if connection in WORDS:
            return f"no answer: {WORDS[connection]}"
        return "no answer, and the broker does not remember it" if robot in self._listed else "no answer"
