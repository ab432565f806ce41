"""Roster: what the broker tells of every robot. Pure; the clocks are arguments."""

from __future__ import annotations

import dataclasses
import json

from failstop.api import words
from failstop.fleet import topics, vda5050

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MOST_BYTES = 65536
"""Of a message: what is longer is not read."""


@dataclasses.dataclass
class Robot:
    """One robot, as far as it was told of."""

    id: str
    """Its name, printable."""
    connection: str = ""
    """ONLINE, OFFLINE or CONNECTIONBROKEN; empty: never told."""
    word: str = ""
    why: str = ""
    next: str = ""
    volts: float | None = None
    latched: bool = False
    driving: bool = False
    errors: tuple[str, ...] = ()
    """Types of those that need a person."""
    warnings: int = 0
    deaf: str = ""
    """Why it obeys no stop of the fleet; empty: it says nothing of the kind."""
    stamped_s: float | None = None
    """Of its last state, by its own clock."""
    heard_s: float | None = None
    """When that came, by this monotonic clock; None: the broker had kept it."""

    def age_s(self, now_s: float, unix_s: float) -> float | None:
        """Of its last state; None: there is none."""
        if self.heard_s is not None:
            return now_s - self.heard_s
        return None if self.stamped_s is None else max(0.0, unix_s - self.stamped_s)

    def lost(self) -> bool:
        """Nothing that is said of it is known to hold now."""
        return self.connection != vda5050.ONLINE


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
            known = self.robots.get(robot) or Robot(words.printable(robot))
            if last == topics.CONNECTION:
                known.connection = str(found["connectionState"])
            elif last == topics.STATE:
                _take_state(known, found, None if retained else now_s)
            else:
                return
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            self.strange += 1
            return
        self.robots[robot] = known

    def sorted(self) -> list[Robot]:
        """By name, numbers in them as numbers."""
        return sorted(self.robots.values(), key=lambda robot: _natural(robot.id))


def _take_state(robot: Robot, found: dict[str, Any], now_s: float | None) -> None:
    """Raises ValueError, KeyError, TypeError, AttributeError, OverflowError for what is no state."""
    told = {row["infoType"]: str(row.get("infoDescription", "")) for row in found.get("information", ())}
    errors = found["errors"]
    stop = found["safetyState"]["eStop"]
    volts = found["batteryState"].get("batteryVoltage")
    robot.driving = found["driving"] is True
    # A robot of another maker has the interface's own fields alone.
    robot.word = words.printable(told.get("word", "") or ("DRIVING" if robot.driving else "STANDING"))
    robot.why, robot.next = words.printable(told.get("why", "")), words.printable(told.get("next", ""))
    robot.latched = stop != "NONE"
    robot.errors = tuple(words.printable(str(row["errorType"])) for row in errors if row["errorLevel"] == vda5050.FATAL)
    robot.warnings = len(errors) - len(robot.errors)
    deaf = [str(row["errorDescription"]) for row in errors if row["errorType"] == vda5050.FLEET_STOP_OFF]
    robot.deaf = words.printable(deaf[0]) if deaf else ""
    robot.volts = float(volts) if volts is not None else None
    robot.stamped_s, robot.heard_s = vda5050.seconds(found["timestamp"]), now_s


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
