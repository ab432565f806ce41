"""Remarks: what people are told by the gate - who enabled, disabled, reset, was refused, left off driving. Pure."""

from __future__ import annotations

from failstop.shm import records
from failstop.shm.packing import Note

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.reply import Reply
    from failstop.procs.gate.sources import Command
    from failstop.shm.packing import Fields

VERBS = {
    records.ENABLE: "enable",
    records.DISABLE: "disable",
    records.RESET: "reset",
    records.ARM_MOVE: "move the arm",
    records.ARM_DRIVE: "move the arm to its drive pose",
    records.ARM_TUCK: "tuck the arm",
    records.ARM_HOLD: "hold the arm",
    records.ARM_RELEASE: "release the arm",
    records.ARM_READ: "read the arm",
    records.LIMIT: "limit the speed",
}
MOST_AT_ONCE = 20
EVERY_NS = 200_000_000
"""A program that asks without end is told of five times a second, not a thousand times."""
HALTS_AT_ONCE = 5
HALTS_EVERY_NS = 10_000_000_000
"""A program that commands more slowly than its timeout starts and stops the wheels forever: that is told of too, now
and then."""


def of_request(verb: int, who: str, pid: int, reply: Reply, *, enabled: bool) -> Note | None:
    """What a request has changed, or that it was refused; None when it has changed nothing. `enabled`: as it was before
    it."""
    by = f"{who} (pid {pid})" if pid else who
    fields: Fields = {"who": who, "pid": pid} if pid else {"who": who}
    named = VERBS.get(verb, str(verb))
    if not reply.done:
        return Note("refused", f"refused to {named}, {by}: {reply}", {**fields, "verb": named, "reason": str(reply)})
    if verb == records.ENABLE and not enabled:
        return Note("enabled", f"motion enabled by {by}", fields)
    if verb == records.DISABLE and enabled:
        return Note("disabled", f"motion disabled by {by}", fields)
    if verb == records.LIMIT:
        return Note("limit", f"{reply} by {by}", fields)
    if verb == records.ARM_RELEASE:
        return Note("arm", f"arm released by {by}", fields)
    if verb == records.RESET and reply.cause:
        return Note("reset", f"{by}: {reply}", {**fields, **reply.cause.fields()})
    return None


def silent(driver: Command, now_ns: int) -> Note:
    """Who drove has sent nothing for its timeout: the wheels stand, and nothing is latched."""
    silent_ms = (now_ns - driver.t_ns) / 1e6
    text = f"{driver.who} fell silent while it drove: last command {silent_ms:.0f} ms ago, the wheels are stopped"
    return Note("driver_silent", text, {"who": driver.who, "source": driver.source, "silent_ms": round(silent_ms, 1)})


def gone(driver: Command) -> Note:
    """Who drove has died, or ended without a word: the wheels stand, and nothing is latched."""
    text = f"{driver.who} has gone while it drove: the wheels are stopped"
    return Note("driver_gone", text, {"who": driver.who, "source": driver.source})


def let_go(driver: Command, now_ns: int) -> Note:
    """A person's command has run out: somebody who drives by hand ends it so, by letting go of a key."""
    silent_ms = (now_ns - driver.t_ns) / 1e6
    text = f"{driver.who} let go: last command {silent_ms:.0f} ms ago, the wheels are stopped"
    return Note("driver_ended", text, {"who": driver.who, "source": driver.source})


def parted(driver: Command) -> Note:
    """Who drove has given its client slot back, which ends its command at once."""
    text = f"{driver.who} ended its command: the wheels are stopped"
    return Note("driver_ended", text, {"who": driver.who, "source": driver.source})


class Budget:
    """How many remarks people are told: some at once, then one at a time."""

    __slots__ = ("_every_ns", "_left", "_most", "_ns", "unsaid")

    def __init__(self, now_ns: int, most: int = MOST_AT_ONCE, every_ns: int = EVERY_NS) -> None:
        self._most = self._left = most
        self._every_ns = every_ns
        self._ns = now_ns
        self.unsaid = 0
        """Those that were left out since the last one that was not."""

    def spend(self, now_ns: int) -> bool:
        """True when one more may be told now."""
        earned = (now_ns - self._ns) // self._every_ns
        self._ns += earned * self._every_ns
        self._left = min(self._most, self._left + earned)
        if not self._left:
            self.unsaid += 1
            return False
        self._left -= 1
        return True
