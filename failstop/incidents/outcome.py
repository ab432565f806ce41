"""Outcome: how a stop was proven, as far as the supervisor has told by the time of saving. Pure."""

from __future__ import annotations

import msgpack

from failstop.shm.records import REQUESTED, printable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

LEVELS = ("noticed_by", "written_by", "written_us", "acknowledged_us", "observed_ms")


def known(record: bytes | None, events: list[bytes], epoch: int, reason: str) -> dict[str, Any] | None:
    """LEVELS and `wheels` (still, unstill or unknown) of the stop for this reason; None when nothing was told of it.

    The supervisor's record of the last stop (supervisor/stops.py) may be of a later one by now; what was told as
    events `stop` and `stop_outcome` is of this one for good.
    """
    found: dict[str, Any] = {}
    last = _map(record)
    if last.get("epoch", 0) >= epoch and _same(last, reason):
        found = {level: last.get(level) for level in LEVELS}
    for payload in events:
        event = _map(payload)
        fields = event.get("fields", {})
        if not isinstance(fields, dict) or not _same(fields, reason) or fields.get("epoch", 0) < epoch:
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


def asked(reason: str) -> tuple[str, str, str]:
    """(the reason without it, by whom, its pid) of a stop that a program or a person asked for, whose reason ends in
    `(WHO, pid N)`; of another one the reason and two empty texts."""
    text, opened, end = reason.rpartition(" (") if reason.startswith(REQUESTED) else ("", "", "")
    who, comma, pid = end.removesuffix(")").rpartition(", pid ")
    if opened and comma and end.endswith(")") and pid.isdigit():
        return text, who, pid
    return reason, "", ""


def _same(found: dict[str, Any], reason: str) -> bool:
    return printable(str(found.get("reason"))) == reason


def _map(payload: bytes | None) -> dict[str, Any]:
    try:
        found = msgpack.unpackb(payload) if payload else {}
    except (ValueError, msgpack.UnpackException):
        return {}
    return found if isinstance(found, dict) else {}
