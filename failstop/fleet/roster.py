"""Roster: what the broker tells of every robot. Pure; the clocks are arguments."""

from __future__ import annotations

import dataclasses
import json

from failstop.api import words
from failstop.fleet import message, topics

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MOST_BYTES = 65536
"""The longest message, bytes. A longer one is not read."""
MOST_VOLTS = 1000.0
MOST_TEXT = 200
"""The longest text that is kept from a robot, characters."""
LONGEST_PERIOD_S = 30.0
"""Between two states of a robot that does not say its own period; robot.publish_s may be no longer."""
MISSED_PERIODS = 3
LATE_S = 2.0
"""A robot is lost after so many periods without a state, and so much for the network."""


@dataclasses.dataclass
class Robot:
    """One robot, as far as it was told of."""

    id: str
    """Its name, printable."""
    connection: str = ""
    """message.ONLINE, OFFLINE or LOST; empty: the broker never showed it."""
    word: str = ""
    why: str = ""
    next: str = ""
    volts: float | None = None
    latched: bool = False
    moves: bool = False
    """It is commanded to move, or its wheels are seen to turn."""
    errors: tuple[str, ...] = ()
    """Types of those that need a person."""
    warnings: int = 0
    deaf: str = ""
    """Why it obeys no stop of the fleet; empty: it says nothing of the kind."""
    doubled: str = ""
    """What it says about another publisher of its name; empty: nothing."""
    period_s: float = LONGEST_PERIOD_S
    """The robot publishes a state at least this often, s."""
    stamped_s: float | None = None
    """When the robot made its last state, by the robot's own clock (Unix, s)."""
    dated_s: float | None = None
    """When the robot made its newest message, by the robot's own clock (Unix, s)."""
    heard_s: float | None = None
    """When its last state came, by this machine's monotonic clock, s. None: the broker had kept it."""
    sign_s: float | None = None
    """When it last showed that it is alive, by this monotonic clock; None: not since this roster began."""
    first_s: float | None = None
    """When its first message came, by this machine's monotonic clock, s."""

    def age_s(self, now_s: float, unix_s: float) -> float | None:
        """The age of its last state, s. None: there is no state."""
        if self.heard_s is not None:
            return now_s - self.heard_s
        return None if self.stamped_s is None else max(0.0, unix_s - self.stamped_s)

    def silent_s(self, now_s: float, unix_s: float) -> float:
        """How long it has shown no sign of life, as far as is known. Of what the broker had kept, by the robot's clock:
        one that is ahead makes it shorter."""
        if self.sign_s is not None:
            return now_s - self.sign_s
        watched_s = 0.0 if self.first_s is None else now_s - self.first_s
        return watched_s if self.dated_s is None else max(watched_s, unix_s - self.dated_s)

    def silent_after_s(self) -> float:
        """Silent for so long, it is lost, whatever the broker calls it: one that was switched off while the broker was
        down stays ONLINE there."""
        return MISSED_PERIODS * self.period_s + LATE_S

    def lost(self, now_s: float, unix_s: float) -> bool:
        """Nothing that it published is known to hold now."""
        silent = self.silent_s(now_s, unix_s) > self.silent_after_s()
        if not self.connection and self.sign_s is not None:
            return silent  # the broker hides its connection, and passes on its states
        return silent or self.connection != message.ONLINE


class Roster:
    """Every robot that was told of."""

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        """By their names in topics."""
        self.strange = 0
        """Messages that could not be read."""

    def hear(self, topic: str, payload: bytes, now_s: float, *, retained: bool) -> None:
        """A message of a robot's; an empty one takes what was there away."""
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
        """By name, numbers in them as numbers."""
        return sorted(self.robots.values(), key=lambda robot: _natural(robot.id))


def _update_state(robot: Robot, found: dict[str, Any], now_s: float | None) -> None:
    """Raises ValueError, KeyError, TypeError, AttributeError, OverflowError for what is no state."""
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
    """A text of a robot's, on one line, and no longer than people read."""
    return words.printable(str(found)[:MOST_TEXT])[:MOST_TEXT]


def _number(found: object, low: float, high: float) -> float | None:
    """A number in that range; None for everything else: JSON here has NaN, and integers of any length."""
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
