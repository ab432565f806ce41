"""A stop: a cause from the moment that somebody noticed it until somebody has answered it with a burst. Pure.

A stop that nobody could write is written later, by whoever gets the port back. proof.py has what a stop has done.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.causes import Cause

WAITS = "nobody yet"
BY_NOTICER = "who noticed it"
BY_PORT_OWNER = "port owner"
BY_SUPERVISOR = "supervisor"
MAY_YET, HAS_ANSWERED, TOO_LATE = range(3)
WRITERS = (
    # may answer, answered, late
    (WAITS, BY_NOTICER, BY_NOTICER),  # its cause came with the time of its burst
    (WAITS, BY_PORT_OWNER, BY_SUPERVISOR),  # the port owner's last burst is about as old as the cause, or younger
    (WAITS, BY_SUPERVISOR, BY_SUPERVISOR),  # neither, or a cause without a time of the port owner's: it could not write
)
"""The process that writes a stop, or has written it: by what is known of its burst, and by the port owner, who has
answered the epoch, may still do so, or is late or dead."""
SOONER_NS = 20_000_000
"""The port owner may have noticed the cause this much sooner; its burst from before that is none for this cause."""


def explained(cause: Cause, suspended_ns: int) -> Cause:
    """The better cause of a silence of the supervisor's, which was suspended for so long (0: it was not)."""
    silent = cause.kind is causes.HELD_UP or (cause.kind is causes.HANGS and cause.arguments[0] == layout.SUPERVISOR)
    return causes.SUPERVISOR_SUSPENDED(suspended_ns / 1e9) if suspended_ns and silent else cause


class Stop(Data):
    """One stop. Times are CLOCK_MONOTONIC in ns."""

    t_ns: int
    noticed_by: str
    cause: Cause
    written_ns: int = 0
    """When its burst was handed to the kernel; 0: not known, or not written."""
    answer_by_ns: int = 0
    """Until when the port owner may answer it."""
    by: str = ""
    """The process that wrote it; empty while none has answered it."""
    epoch: int = 0
    behind: Stop | None = None
    """The one that was latched when it was answered; None: this one itself."""

    def fields(self) -> dict[str, str | int]:
        """Of an event: its cause, and the time that tells it from any other stop for the same cause."""
        return {**self.cause.fields(), "noticed_ns": self.t_ns}

    def who_wrote(self, *, answered: bool, may_answer: bool, port_owner_ns: int) -> tuple[str, int] | None:
        """Return (by whom, when in ns; 0: the supervisor is to write it now), or None to wait: see WRITERS.
        `may_answer`: the port owner lives and has had little time; `port_owner_ns`: its last burst."""
        own = self.noticed_by == layout.PORT_OWNER
        recent = not own and port_owner_ns >= self.t_ns - SOONER_NS
        row = WRITERS[0 if self.written_ns else 1 if recent else 2]
        by = row[HAS_ANSWERED if answered else MAY_YET if may_answer else TOO_LATE]
        if by == BY_NOTICER:
            return (BY_PORT_OWNER if own else BY_SUPERVISOR), self.written_ns
        return None if by == WAITS else (by, port_owner_ns if by == BY_PORT_OWNER else 0)

    def answered_by(self, by: str, written_ns: int, latched: Stop, epoch: int) -> None:
        """Take who has written it, and when (0: it could not be written), while `latched` was latched."""
        self.by = by
        self.written_ns = written_ns
        self.behind = None if latched is self else latched  # nobody collects what refers to itself
        self.epoch = epoch
