"""A stop: a cause, from the moment when a process notices it until the burst for it is written. Pure.

If no process could write the stop, the process that gets the port back writes it later. What the stop achieved is in
proof.py.
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
    # columns: the port owner may still answer, has answered, is late
    (WAITS, BY_NOTICER, BY_NOTICER),  # the process that noticed the cause also reported when it wrote the burst
    (WAITS, BY_PORT_OWNER, BY_SUPERVISOR),  # the port owner has written a burst recently enough
    (WAITS, BY_SUPERVISOR, BY_SUPERVISOR),  # there is no such burst, or the port owner could not write
)
"""Which process has written a stop, or must write it. The rows are what is known about its burst. The columns are
whether the port owner may still answer the epoch, has answered it, or is late or dead."""
SOONER_NS = 20_000_000
"""The port owner may have noticed the same cause this much earlier, so its burst counts for a cause noticed up to this
much later. An older burst does not count."""


def explained(cause: Cause, suspended_ns: int) -> Cause:
    """Replace a cause that only says that the supervisor was silent, if a signal suspended the supervisor. Other causes
    stay as they are. `suspended_ns`: how long it was suspended, or 0."""
    silent = cause.kind is causes.HELD_UP or (cause.kind is causes.HANGS and cause.arguments[0] == layout.SUPERVISOR)
    return causes.SUPERVISOR_SUSPENDED(suspended_ns / 1e9) if suspended_ns and silent else cause


class Stop(Data):
    """One stop. All times are CLOCK_MONOTONIC in ns."""

    t_ns: int
    noticed_by: str
    cause: Cause
    written_ns: int = 0
    """When its burst was handed to the kernel. 0 if that is not known, or if the burst was not written."""
    answer_by_ns: int = 0
    """Until when the port owner may answer the stop."""
    by: str = ""
    """The process that wrote the stop; empty until it is answered."""
    epoch: int = 0
    behind: Stop | None = None
    """The stop that was already latched when this one was answered, or None if this one is latched."""

    def fields(self) -> dict[str, str | int]:
        """The fields for an event: the cause, and the time, which distinguishes stops with the same cause."""
        return {**self.cause.fields(), "noticed_ns": self.t_ns}

    def who_wrote(self, *, answered: bool, may_answer: bool, port_owner_ns: int) -> tuple[str, int] | None:
        """Find out which process has written the stop (see WRITERS). Returns (process, time of the burst in ns), with
        time 0 if the supervisor must write it now. Returns None if it is still time to wait.

        `answered`: the port owner has answered the epoch. `may_answer`: it is alive and its time is not over.
        `port_owner_ns`: when it last wrote a burst.
        """
        own = self.noticed_by == layout.PORT_OWNER
        recent = not own and port_owner_ns >= self.t_ns - SOONER_NS
        row = WRITERS[0 if self.written_ns else 1 if recent else 2]
        by = row[HAS_ANSWERED if answered else MAY_YET if may_answer else TOO_LATE]
        if by == BY_NOTICER:
            return (BY_PORT_OWNER if own else BY_SUPERVISOR), self.written_ns
        return None if by == WAITS else (by, port_owner_ns if by == BY_PORT_OWNER else 0)

    def answered_by(self, by: str, written_ns: int, latched: Stop, epoch: int) -> None:
        """Record which process wrote the stop and when (0 if it could not be written). `latched`: the stop that was
        latched at that time."""
        self.by = by
        self.written_ns = written_ns
        self.behind = None if latched is self else latched  # a stop that refers to itself would never be freed
        self.epoch = epoch
