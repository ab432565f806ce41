"""Roster: collects what the robots publish on the broker. Pure: every time is an argument."""

from __future__ import annotations

import dataclasses
import json

from failstop.api import words
from failstop.fleet import message, topics

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MOST_BYTES = 65536
"""The longest message that is read, bytes."""
MOST_VOLTS = 1000.0
MOST_TEXT = 200
"""The longest text of a robot that is kept, characters."""
LONGEST_PERIOD_S = 30.0
"""The largest allowed value of the setting robot.publish_s, s. That setting says how often a robot publishes its state
even if the state does not change. If a robot does not report its setting, this value is assumed."""
MISSED_PERIODS = 3
LATE_S = 2.0
"""The time that is allowed for delays of the network, s. A robot counts as lost if it has been silent for longer than
MISSED_PERIODS times its period, plus this time."""


@dataclasses.dataclass
class Robot:
    """What is known about one robot from its messages."""

    id: str
    """The robot's name, with printable characters only."""
    connection: str = ""
    """message.ONLINE, OFFLINE or LOST. Empty if the broker has not sent a message about the robot's connection."""
    word: str = ""
    why: str = ""
    next: str = ""
    volts: float | None = None
    latched: bool = False
    moves: bool = False
    """True if the robot is commanded to move, or if its wheels are seen to turn."""
    errors: tuple[str, ...] = ()
    """The kinds of errors that need a person."""
    warnings: int = 0
    deaf: str = ""
    """Why the robot would obey no fleet stop, according to the robot itself. Empty if the robot reports no reason."""
    doubled: str = ""
    """The robot's warning that another publisher uses its name. Empty if there is no warning."""
    period_s: float = LONGEST_PERIOD_S
    """The longest time between two state messages of this robot, s."""
    stamped_s: float | None = None
    """When the robot made its newest state message, by its own clock (Unix time, s)."""
    dated_s: float | None = None
    """When the robot made its newest sign of life, by its own clock (Unix time, s). A sign of life is a state message,
    or a connection message with ONLINE."""
    heard_s: float | None = None
    """When the newest state message arrived (this computer's monotonic clock, s). None if the message came from the
    broker's store, because a stored message may be of any age."""
    sign_s: float | None = None
    """When the robot last showed that it is alive (this computer's monotonic clock, s). None if the robot has shown no
    sign of life since this roster was created."""
    first_s: float | None = None
    """When the robot's first message arrived (this computer's monotonic clock, s)."""

    def age_s(self, now_s: float, unix_s: float) -> float | None:
        """Return the age of the newest state message, s. None if the robot has published no state."""
        if self.heard_s is not None:
            return now_s - self.heard_s
        return None if self.stamped_s is None else max(0.0, unix_s - self.stamped_s)

    def silent_s(self, now_s: float, unix_s: float) -> float:
        """Return how long the robot has shown no sign of life, s. If all its signs of life came from the broker's
        store, the newest date in them is used. If the robot's clock is ahead, the result is then too small."""
        if self.sign_s is not None:
            return now_s - self.sign_s
        watched_s = 0.0 if self.first_s is None else now_s - self.first_s
        return watched_s if self.dated_s is None else max(watched_s, unix_s - self.dated_s)

    def silent_after_s(self) -> float:
        """Return how long a robot may be silent until it counts as lost, s. This limit also applies to a robot that the
        broker reports as ONLINE, because this report may be wrong: if a robot is switched off while the broker is down,
        the broker does not notice it."""
        return MISSED_PERIODS * self.period_s + LATE_S

    def lost(self, now_s: float, unix_s: float) -> bool:
        """Return True if the robot counts as lost. Everything that the robot has published may then be out of date."""
        silent = self.silent_s(now_s, unix_s) > self.silent_after_s()
        if not self.connection and self.sign_s is not None:
            return silent  # the broker hides the robot's connection messages, but shows its states
        return silent or self.connection != message.ONLINE


class Roster:
    """Collects what the robots publish."""

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        """The robots. Each key is the robot's name as it is in topics."""
        self.strange = 0
        """How many messages could not be read."""

    def hear(self, topic: str, payload: bytes, now_s: float, *, retained: bool) -> None:
        """Add a robot's message to what is known. An empty message removes the robot, because somebody has removed the
        robot's stored message from the broker."""
        robot, last = topics.robot_of(topic)
        if not payload:
            self.robots.pop(robot, None)
            return
        try:
            if len(payload) > MOST_BYTES:
                raise ValueError
            found = json.loads(payload)
            known = self.robots.get(robot) or Robot(_text(robot), first_s=now_s)
            if last == topics.CONNECTION:
                known.connection = _text(found["connection"])
                known.period_s = _number(found.get("state_period_s"), 0.0, LONGEST_PERIOD_S) or LONGEST_PERIOD_S
                alive = known.connection == message.ONLINE
            elif last == topics.STATE:
                _update_state(known, found, None if retained else now_s)
                alive = True
            else:
                return
            if alive:
                # The broker's stored messages come in any order.
                known.dated_s = _newest(known.dated_s, message.date(found.get("t")))
                known.sign_s = known.sign_s if retained else now_s
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            self.strange += 1
            return
        self.robots[robot] = known

    def sorted(self) -> list[Robot]:
        """Return the robots sorted by name. Numbers in names are compared as numbers, so robot-2 comes before
        robot-10."""
        return sorted(self.robots.values(), key=lambda robot: _natural(robot.id))


def _newest(*dates_s: float | None) -> float | None:
    """Return the newest of these dates, s. None if none of them is known."""
    return max((date_s for date_s in dates_s if date_s is not None), default=None)


def _update_state(robot: Robot, found: dict[str, Any], now_s: float | None) -> None:
    """Copy a state message into the robot. Raises ValueError, KeyError, TypeError, AttributeError or OverflowError if
    the message is malformed."""
    errors = found["errors"]
    robot.volts = _number(found.get("battery", {}).get("volts"), -MOST_VOLTS, MOST_VOLTS)
    robot.moves = found.get("moves") is True
    robot.word, robot.why, robot.next = (_text(found[key]) for key in ("word", "why", "next"))
    robot.latched = found.get("latched") is True
    robot.errors = tuple(_text(row["kind"]) for row in errors if row["level"] == message.FATAL)
    robot.warnings = len(errors) - len(robot.errors)
    own = {row["kind"]: _text(row["text"]) for row in reversed(errors)}
    robot.deaf, robot.doubled = own.get(message.FLEET_STOP_OFF, ""), own.get(message.DOUBLED, "")
    robot.stamped_s, robot.heard_s = message.date(found["t"]), now_s


def _text(found: object) -> str:
    """Return a robot's text as one printable line of at most MOST_TEXT characters."""
    return words.printable(str(found)[:MOST_TEXT])[:MOST_TEXT]


def _number(found: object, low: float, high: float) -> float | None:
    """Return the value if it is a number between `low` and `high`, else None. A robot's JSON may also contain NaN or a
    huge integer."""
    if isinstance(found, bool) or not isinstance(found, (int, float)) or not low <= found <= high:
        return None
    return float(found)


def _natural(name: str) -> list[tuple[int, int, str]]:
    parts: list[tuple[int, int, str]] = []
    digits = ""
    for c in f"{name}\0":
        if c.isascii() and c.isdigit():
            digits += c
            continue
        if digits:
            # Compare the length first, and then the digits. Python refuses to read a number of thousands of digits.
            number = digits.lstrip("0")
            parts.append((0, len(number), number))
            digits = ""
        parts.append((1, 0, c))
    return parts
