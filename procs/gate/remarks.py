"""Remarks: what people are told of the gate's requests - who enabled, disabled, reset, who was refused. Pure."""

from __future__ import annotations

from failstop.shm import records
from failstop.shm.notes import Note

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.notes import Fields

VERBS = {records.ENABLE: "enable", records.DISABLE: "disable", records.RESET: "reset"}
MOST_AT_ONCE = 20
EVERY_NS = 200_000_000
"""A program that asks without end is told of five times a second, not a thousand times."""


def of_request(
    verb: int, who: str, pid: int, done: bool, text: str, *, enabled: bool, latched: str | None
) -> Note | None:
    """What a request has changed, or that it was refused; None when it has changed nothing. `enabled` and `latched`:
    as they were before it."""
    by = f"{who} (pid {pid})" if pid else who
    fields: Fields = {"who": who, "pid": pid} if pid else {"who": who}
    named = VERBS.get(verb, str(verb))
    if not done:
        return Note("refused", f"refused to {named}, {by}: {text}", {**fields, "verb": named, "reason": text})
    if verb == records.ENABLE and not enabled:
        return Note("enabled", f"motion enabled by {by}", fields)
    if verb == records.DISABLE and enabled:
        return Note("disabled", f"motion disabled by {by}", fields)
    if verb == records.RESET and latched is not None:
        return Note("reset", f"{by}: {text}", {**fields, "reason": latched})
    return None


class Budget:
    """How many remarks people are told: some at once, then one at a time."""

    __slots__ = ("_left", "_ns", "unsaid")

    def __init__(self, now_ns: int) -> None:
        self._left = MOST_AT_ONCE
        self._ns = now_ns
        self.unsaid = 0
        """Those that were left out since the last one that was not."""

    def spend(self, now_ns: int) -> bool:
        """True when one more may be told now."""
        earned = (now_ns - self._ns) // EVERY_NS
        self._ns += earned * EVERY_NS
        self._left = min(MOST_AT_ONCE, self._left + earned)
        if not self._left:
            self.unsaid += 1
            return False
        self._left -= 1
        return True
