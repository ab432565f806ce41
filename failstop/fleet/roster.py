"""Roster: what the robots have published on the broker. Pure; the clocks are arguments."""

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
"""The longest text that is kept from a robot, characters."""
LONGEST_PERIOD_S = 30.0
"""The time between two states of a robot that does not report its own period, s. The setting robot.publish_s can't be
longer."""
MISSED_PERIODS = 3
LATE_S = 2.0
"""A robot counts as lost if it is silent for this many of its periods, plus this many seconds for the network."""


@dataclasses.dataclass
class Robot:
    """One robot, as far as it has published anything."""

    id: str
    """Its name, with printable characters only."""
    connection: str = ""
    """message.ONLINE, OFFLINE or LOST; empty if the broker has never reported it."""
    word: str = ""
    why: str = ""
    next: str = ""
    volts: float | None = None
    latched: bool = False
    moves: bool = False
    """True if it is commanded to move, or its wheels are seen to turn."""
    errors: tuple[str, ...] = ()
    """The kinds of its errors that need a person."""
    warnings: int = 0
    deaf: str = ""
    """Why it would obey no fleet stop; empty if it reports no such error."""
    doubled: str = ""
    """Its report about another publisher of its name; empty if it has reported none."""
    period_s: float = LONGEST_PERIOD_S
    """The robot publishes a state at least this often, s."""
    stamped_s: float | None = None
    """When the robot made its last state, by the robot's own clock (Unix, s)."""
    dated_s: float | None = None
    """When the robot made its newest message, by the robot's own clock (Unix, s)."""
    heard_s: float | None = None
    """When its last state arrived, by this computer's monotonic clock, s. None if the broker had stored that state."""
    sign_s: float | None = None
    """When it last showed that it is alive, by this computer's monotonic clock, s; None: not since this roster
    began."""
    first_s: float | None = None
    """When its first message arrived, by this computer's monotonic clock, s."""

    def age_s(self, now_s: float, unix_s: float) -> float | None:
        """The age of its last state, s; None if it has published none."""
        if self.heard_s is not None:
            return now_s - self.heard_s
        return None if self.stamped_s is None else max(0.0, unix_s - self.stamped_s)

    def silent_s(self, now_s: float, unix_s: float) -> float:
        """For how long it has shown no sign of life, s, as far as is known. The age of a message that the broker had
        stored is taken from the robot's clock, so it seems younger if that clock is ahead."""
        if self.sign_s is not None:
            return now_s - self.sign_s
        watched_s = 0.0 if self.first_s is None else now_s - self.first_s
        return watched_s if self.dated_s is None else max(watched_s, unix_s - self.dated_s)

    def silent_after_s(self) -> float:
        """After how long a silence, s, the robot counts as lost, even if the broker still calls it ONLINE. The broker
        does that for a robot that was switched off while the broker was down."""
        return MISSED_PERIODS * self.period_s + LATE_S

    def lost(self, now_s: float, unix_s: float) -> bool:
        """True if the robot is lost, so that nothing that it has published is known to be true now."""
        silent = self.silent_s(now_s, unix_s) > self.silent_after_s()
        if not self.connection and self.sign_s is not None:
            return silent  # the broker hides its connection, and passes on its states
        return silent or self.connection != message.ONLINE


class Roster:
    """Every robot that has published something."""

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        """The robots by their names in topics."""
        self.strange = 0
        """How many messages could not be read."""

    def hear(self, topic: str, payload: bytes, now_s: float, *, retained: bool) -> None:
        """Take in a robot's message. An empty message removes what the broker had stored."""
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
                known.dated_s = message.date(found.get("t"))
                known.sign_s = known.sign_s if retained else now_s
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            self.strange += 1
            return
        self.robots[robot] = known

    def sorted(self) -> list[Robot]:
        """The robots by name; numbers in names are compared as numbers."""
        return sorted(self.robots.values(), key=lambda robot: _natural(robot.id))


def _update_state(robot: Robot, found: dict[str, Any], now_s: float | None) -> None:
    """Take in a state message. Raises ValueError, KeyError, TypeError, AttributeError or OverflowError if it is not
    one."""
    errors = found["errors"]
    robot.volts = _number(found.get("battery", {}).get("volts"), -MOST_VOLTS, MOST_VOLTS)
    robot.moves = found["moves"] is True
    robot.word, robot.why, robot.next = (_text(found[key]) for key in ("word", "why", "next"))
    robot.latched = found.get("latched") is True
    robot.errors = tuple(_text(row["kind"]) for row in errors if row["level"] == message.FATAL)
    robot.warnings = len(errors) - len(robot.errors)
    own = {row["kind"]: _text(row["text"]) for row in reversed(errors)}
    robot.deaf, robot.doubled = own.get(message.FLEET_STOP_OFF, ""), own.get(message.DOUBLED, "")
    robot.stamped_s, robot.heard_s = message.date(found["t"]), now_s


def _text(found: object) -> str:
    """A robot's text on one line, cut to the length that people read."""
    return words.printable(str(found)[:MOST_TEXT])[:MOST_TEXT]


def _number(found: object, low: float, high: float) -> float | None:
    """The number, if it is in this range; None for anything else, because JSON as Python reads it has NaN and integers
    of any length."""
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
            # By length first, as numbers: one of thousands of digits is none that Python reads.
            number = digits.lstrip("0")
            parts.append((0, len(number), number))
            digits = ""
        parts.append((1, 0, c))
    return parts
