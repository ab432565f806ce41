"""Levels: how far a fleet stop has come on one robot, and the two messages about it: the order and the answer. Pure."""

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
"""The stop's date is too old, or too far ahead."""
FAILED = "failed"
"""The stop could not be requested, or was not written."""
ASKED = "asked"
"""The request is in the stop pipe."""
WRITTEN = "written"
"""The kernel has the bytes of the stop."""
ACKNOWLEDGED = "acknowledged"
"""The board has answered a ping that was written after the stop."""
OBSERVED = "observed"
"""The IMU shows that the wheels are still."""
PROOFS = (WRITTEN, ACKNOWLEDGED, OBSERVED)
ORDER = (REFUSED, FAILED, ASKED, *PROOFS)
MOST_TEXT = 120
"""The longest reason or name, characters."""


@dataclasses.dataclass(frozen=True)
class Order:
    """A fleet stop, as its sender orders it."""

    id: str
    unix_s: float
    """When the order was signed, by the sender's clock (Unix time, s)."""
    reason: str
    by: str

    def message(self, key: bytes) -> bytes:
        """The signed message. However long the reason is, the message is no longer than robots accept."""
        body = {"id": self.id, "t": self.unix_s, "reason": self.reason[:MOST_TEXT], "by": self.by[:MOST_TEXT]}
        return signed.sign(key, signed.STOP_PURPOSE, body)


def read_order(key: bytes, message: bytes) -> Order:
    """The order in a message. Raises signed.Forged."""
    body = signed.verify(key, signed.STOP_PURPOSE, message)
    return Order(_id(body), _number(body, "t"), _text(body, "reason"), _text(body, "by"))


@dataclasses.dataclass(frozen=True)
class StopAnswer:
    """A robot's answer to a fleet stop."""

    id: str
    """The id of the stop."""
    robot: str
    reached: dict[str, float]
    """Every level that the stop has reached on this robot, with the seconds after which it did."""
    why: str = ""
    """The reason, for REFUSED and FAILED."""
    confirms: str = ACKNOWLEDGED
    """The level that confirms the stop: the first one that this robot's board or IMU can give."""
    publisher: str = ""
    """The random number of the publisher (twins.py); empty for an older failstop, which has none."""
    doubled: bool = False
    """True if the publisher knows of another one that uses its name."""
    connected_s: float = 0.0
    """How long the publisher's connection to the broker has lasted, s. The broker has been running for at least as
    long."""

    def message(self, key: bytes) -> bytes:
        """The signed message."""
        body: dict[str, Any] = {"id": self.id, "robot": self.robot, "reached": self.reached}
        body |= {"why": self.why, "confirms": self.confirms}
        body |= {"publisher": self.publisher, "doubled": self.doubled, "connected_s": self.connected_s}
        return signed.sign(key, signed.ANSWER_PURPOSE, body)


def read_answer(key: bytes, message: bytes) -> StopAnswer:
    """The answer in a message. Raises signed.Forged."""
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
