"""Levels: how far a stop of the fleet has come on one robot, and the two messages that tell of it. Pure."""

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
"""It is too old, or too far ahead."""
FAILED = "failed"
"""Nothing could be asked for here, or it was not written."""
ASKED = "asked"
"""It is in the stop pipe."""
WRITTEN = "written"
"""The kernel has its bytes."""
ACKNOWLEDGED = "acknowledged"
"""The board answered a ping that was written after it."""
OBSERVED = "observed"
"""The IMU calls the wheels still."""
PROOFS = (WRITTEN, ACKNOWLEDGED, OBSERVED)
ORDER = (REFUSED, FAILED, ASKED, *PROOFS)
MOST_TEXT = 120
"""Characters of a reason or a name."""


@dataclasses.dataclass(frozen=True)
class Order:
    """A stop of the fleet."""

    id: str
    unix_s: float
    """When it was signed, by the sender's clock."""
    reason: str
    by: str

    def message(self, key: bytes) -> bytes:
        """Signed; no longer than robots read, whatever the reason."""
        body = {"id": self.id, "t": self.unix_s, "reason": self.reason[:MOST_TEXT], "by": self.by[:MOST_TEXT]}
        return signed.sign(key, signed.STOP_PURPOSE, body)


def read_order(key: bytes, message: bytes) -> Order:
    """Raises signed.Forged."""
    body = signed.verify(key, signed.STOP_PURPOSE, message)
    return Order(_id(body), _number(body, "t"), _text(body, "reason"), _text(body, "by"))


@dataclasses.dataclass(frozen=True)
class StopAnswer:
    """A robot's answer to a stop of the fleet."""

    id: str
    """The stop's."""
    robot: str
    reached: dict[str, float]
    """Every level that it has come to, and after how many seconds at the robot."""
    why: str = ""
    """In words, for REFUSED and FAILED."""
    confirms: str = ACKNOWLEDGED
    """The level that confirms the stop: the first that its board and its IMU can give."""
    publisher: str = ""
    """The number that its publisher drew. Empty: an older failstop, which draws none."""
    doubled: bool = False
    """Its publisher knows of another one with its name."""
    connected_s: float = 0.0
    """How long its connection to the broker has lasted. The broker has run for at least as long."""

    def message(self, key: bytes) -> bytes:
        """Signed."""
        body: dict[str, Any] = {"id": self.id, "robot": self.robot, "reached": self.reached}
        body |= {"why": self.why, "confirms": self.confirms}
        body |= {"publisher": self.publisher, "doubled": self.doubled, "connected_s": self.connected_s}
        return signed.sign(key, signed.ANSWER_PURPOSE, body)


def read_answer(key: bytes, message: bytes) -> StopAnswer:
    """Raises signed.Forged."""
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
