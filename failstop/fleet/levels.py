"""Levels: the stages that a fleet stop reaches on a robot, from "asked" to "observed". This module also has the two
messages about a stop: the order, and a robot's answer. Pure."""

from __future__ import annotations

import dataclasses
import math

from failstop.api import words
from failstop.fleet import replay, signed
from failstop.fleet.twins import number_of

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

REFUSED = "refused"
"""The robot refused the stop, because the date of the stop is too old or too far in the future."""
FAILED = "failed"
"""The robot could not request the stop from its service, or the stop was not written to the board."""
ASKED = "asked"
"""The robot has requested the stop from its service."""
WRITTEN = "written"
"""The kernel has taken the bytes of the stop."""
ACKNOWLEDGED = "acknowledged"
"""The board has answered a ping that was sent after the stop."""
OBSERVED = "observed"
"""The robot has seen that its wheels are still."""
PROOFS = (WRITTEN, ACKNOWLEDGED, OBSERVED)
ORDER = (REFUSED, FAILED, ASKED, *PROOFS)
LONGEST_S = 3600.0
"""The longest time for which a sender waits for answers to its stop, in seconds."""
MOST_TEXT = 120
"""The longest allowed reason or name, in characters."""


@dataclasses.dataclass(frozen=True)
class Order:
    """A fleet stop, as its sender ordered it."""

    id: str
    unix_s: float
    """When the sender signed the order, by its own clock (Unix time, s)."""
    reason: str
    by: str

    def message(self, key: bytes) -> bytes:
        """Return the signed message. A long reason or name is cut to MOST_TEXT."""
        body = {"id": self.id, "t": self.unix_s, "reason": self.reason[:MOST_TEXT], "by": self.by[:MOST_TEXT]}
        return signed.sign(key, signed.STOP_PURPOSE, body)


def read_order(key: bytes, message: bytes) -> Order:
    """Read the order from a signed message. Raises signed.Forged."""
    body = signed.verify(key, signed.STOP_PURPOSE, message)
    return Order(_id(body), _number(body, "t"), _text(body, "reason"), _text(body, "by"))


@dataclasses.dataclass(frozen=True)
class StopAnswer:
    """A robot's answer to a fleet stop."""

    id: str
    """The id of the stop that is answered."""
    robot: str
    reached: dict[str, float]
    """All levels that the stop has reached on this robot. The value of a level is the time in seconds from the request
    until the robot's publisher saw that the level was reached."""
    why: str = ""
    """Why the stop was refused or has failed, or what contradicts the levels in `reached`, for example that the wheels
    turn. Otherwise empty."""
    confirms: str = ACKNOWLEDGED
    """The level that confirms the stop on this robot (see duties.confirming())."""
    publisher: str = ""
    """The random number of the robot's publisher (twins.py). Empty if the robot has an old version of failstop, whose
    publisher draws no number."""
    doubled: bool = False
    """True if the robot's publisher knows that a second publisher uses the robot's name."""
    connected_s: float = 0.0
    """How long the publisher has been connected to the broker, s. The broker has been running for at least that
    long."""
    observes: bool = False
    """True if the robot has observed, or may still observe, that its wheels have come to rest (see
    duties.observing())."""

    def message(self, key: bytes) -> bytes:
        """Return the signed message."""
        body: dict[str, Any] = {"id": self.id, "robot": self.robot, "reached": self.reached}
        body |= {"why": self.why, "confirms": self.confirms, "observes": self.observes}
        body |= {"publisher": self.publisher, "doubled": self.doubled, "connected_s": self.connected_s}
        return signed.sign(key, signed.ANSWER_PURPOSE, body)


def read_answer(key: bytes, message: bytes) -> StopAnswer:
    """Read a robot's answer from a signed message. Raises signed.Forged."""
    body = signed.verify(key, signed.ANSWER_PURPOSE, message)
    reached = body.get("reached")
    if not isinstance(reached, dict) or not set(reached) <= set(ORDER):
        raise signed.Forged("no levels")
    known = {level: _number(reached, level) for level in reached}
    confirms = body.get("confirms", ACKNOWLEDGED)
    if confirms not in PROOFS:
        raise signed.Forged("no level that confirms")
    connected_s = _number(body, "connected_s") if "connected_s" in body else 0.0
    return StopAnswer(
        _id(body),
        _text(body, "robot"),
        known,
        _text(body, "why"),
        confirms,
        number_of(body.get("publisher")),
        body.get("doubled", False) is not False,
        connected_s if 0.0 <= connected_s < math.inf else 0.0,
        body.get("observes") is True,
    )


def _id(body: dict[str, Any]) -> str:
    found = body.get("id")
    if not isinstance(found, str) or not replay.ID.fullmatch(found):
        raise signed.Forged("no id")
    return found


def _text(body: dict[str, Any], key: str) -> str:
    found = body.get(key)
    if not isinstance(found, str):
        raise signed.Forged(f"no {key}")
    return words.printable(found[:MOST_TEXT])[:MOST_TEXT]


def _number(body: dict[str, Any], key: str) -> float:
    found = body.get(key)
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        raise signed.Forged(f"no {key}")
    try:
        return float(found)
    except OverflowError:
        raise signed.Forged(f"no {key}") from None
