"""Outcome: how a stop was proven, as far as the supervisor has told by the time of saving. Pure."""

from __future__ import annotations

import msgpack

from failstop.api.words import took
from failstop.policy import causes
from failstop.supervisor.stops import wheels_seen

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.policy.causes import Cause

UNSTILL = "wheels NOT seen still"
LEVELS = ("noticed_by", "written_by", "written_us", "acknowledged_us", "observed_ms")


def known(record: bytes | None, events: list[bytes], epoch: int, cause: Cause) -> dict[str, Any] | None:
    """LEVELS and `wheels` (still, unstill or unknown) of the stop for this cause; None when nothing was told of it.

    The supervisor's record of the last stop (supervisor/stops.py) may be of a later one by now; what was told as
    events `stop` and `stop_outcome` is of this one for good.
    """
    found: dict[str, Any] = {}
    last = _map(record)
    if last.get("epoch", 0) >= epoch and last.get("cause") == cause.pack():
        found = {level: last.get(level) for level in LEVELS}
    for payload in events:
        event = _map(payload)
        fields = event.get("fields", {})
        if not isinstance(fields, dict) or not tells_of(fields, cause) or fields.get("epoch", 0) < epoch:
            continue
        if event.get("kind") == "stop":
            found.setdefault("noticed_by", fields.get("noticed_by"))
            found.setdefault("written_by", fields.get("written_by"))
            found.setdefault("written_us", fields.get("latency_us"))
        elif event.get("kind") == "stop_outcome":
            found |= {key: fields[key] for key in ("acknowledged_us", "observed_ms", "wheels") if key in fields}
    if not found:
        return None
    return dict.fromkeys(LEVELS) | {"wheels": "unknown"} | found


def proof(stop: dict[str, Any] | None, head: dict[str, Any]) -> str:
    """How the stop was proven, the three levels in a few words; `head` tells how long after it the file was saved."""
    if stop is None:
        return "not known whether a stop was written"
    parts = [f"NOT written within {took(max(0.0, head['saved'] - head['t']))}"]
    if stop.get("written_us") is not None:
        parts = [f"written after {took(stop['written_us'] / 1e6)}"]
    if (heard_us := stop.get("acknowledged_us")) is not None:
        parts.append(f"acknowledged after {took(heard_us / 1e6)}")
    if (seen_ms := stop.get("observed_ms")) is not None:
        # Without a word that would not fit a line of 80 columns.
        parts.append(wheels_seen(seen_ms / 1e3).removeprefix("wheels "))
    elif stop.get("wheels") == "unstill":
        parts.append(UNSTILL)
    return ", ".join(parts)


def tells_of(fields: dict[str, Any], cause: Cause) -> bool:
    """True when an event with these fields is of this cause, as far as its text was not cut."""
    return fields.get("cause") == cause.kind.name and str(cause).startswith(str(fields.get("reason", "")))


def asked(cause: Cause) -> bool:
    """True when a program or a person asked for it."""
    return cause.kind in (causes.REQUESTED, causes.FLEET, causes.PIPED)


def short(cause: Cause) -> str:
    """Its text without who asked for it."""
    if cause.kind is causes.FLEET:
        return str(cause).removesuffix(f" (by {cause.named()['who']})")
    return str(causes.PIPED(cause.named()["words"])) if cause.kind is causes.REQUESTED else str(cause)


def _map(payload: bytes | None) -> dict[str, Any]:
    try:
        found = msgpack.unpackb(payload) if payload else {}
    except (ValueError, msgpack.UnpackException):
        return {}
    return found if isinstance(found, dict) else {}
