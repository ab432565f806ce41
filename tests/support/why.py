"""Causes by a word, for tests that need several which can be told apart."""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Cause, Reply

KNOWN = {
    str(cause): cause
    for cause in (
        causes.KEY(1),
        causes.DEVICE_LOST(),
        *(causes.DIED(name) for name in ("gate", "port_owner", "stopper", "supervisor", "telemetry")),
    )
}


def why(text: str) -> Cause:
    """The cause with this text, where there is one; else that somebody typed it."""
    return KNOWN.get(text) or causes.PIPED(text)


def said(cause: Cause | None) -> str:
    assert cause is not None
    return str(cause.named()["words"]) if cause.kind is causes.PIPED else str(cause)


def told(reply: Reply) -> tuple[bool, str]:
    return bool(reply.done), str(reply)
