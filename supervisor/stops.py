"""A stop, from the moment when a process notices its cause until the stop burst is written. Pure.

While the port is lost, no process can write the burst. It is written as soon as the port is open again. proof.py judges
the effect of a stop.
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
"""Which process has written a stop, or must write it.

The row depends on what is known about the burst, as the comments at the rows say. The column depends on the port owner:
it may still answer the new epoch with a stop, or it has answered, or it is late or dead.
"""
SOONER_NS = 20_000_000
"""If another process reports a cause, the port owner may have noticed the same cause a little earlier. So if the port
owner wrote a burst at most this long before the other process noticed the cause, this burst counts as the stop for the
cause."""


def explained(cause: Cause, suspended_ns: int) -> Cause:
    """Return a cause that names the suspension, if a signal had suspended the supervisor and the cause is the
    supervisor's silence. Otherwise return the cause unchanged. `suspended_ns`: how long the supervisor was suspended; 0
    if it was not."""
    silent = cause.kind is causes.HELD_UP or (cause.kind is causes.HANGS and cause.arguments[0] == layout.SUPERVISOR)
    return causes.SUPERVISOR_SUSPENDED(suspended_ns / 1e9) if suspended_ns and silent else cause


class Stop(Data):
    """One stop. All times are CLOCK_MONOTONIC in ns."""

    t_ns: int
    noticed_by: str
    cause: Cause
    written_ns: int = 0
    """When the burst for this stop was handed to the kernel. 0 if no burst was written, or if the time is not known."""
    answer_by_ns: int = 0
    """The port owner may answer the stop until this time. After that, the supervisor writes the burst."""
    by: str = ""
    """The process that wrote the stop. Empty until this is decided."""
    epoch: int = 0
    behind: Stop | None = None
    """The stop that was already latched when this stop was written. None if this stop itself is latched."""

    def fields(self) -> dict[str, str | int]:
        """Fields for an event about this stop: the cause, and the time when it was noticed. The time distinguishes
        stops with the same cause."""
        return {**self.cause.fields(), "noticed_ns": self.t_ns}

    def who_wrote(self, *, answered: bool, may_answer: bool, port_owner_ns: int) -> tuple[str, int] | None:
        """Return (the process that has written the stop, the time of its burst in ns), as decided by WRITERS. The time
        is 0 if the supervisor must write the burst now. Returns None while the port owner may still write the burst.

        `answered`: True if the port owner has answered the epoch. `may_answer`: True if the port owner is alive and
        still has time to answer. `port_owner_ns`: when the port owner last wrote a burst.
        """
        own = self.noticed_by == layout.PORT_OWNER
        recent = not own and port_owner_ns >= self.t_ns - SOONER_NS
        row = WRITERS[0 if self.written_ns else 1 if recent else 2]
        by = row[HAS_ANSWERED if answered else MAY_YET if may_answer else TOO_LATE]
        if by == BY_NOTICER:
            return (BY_PORT_OWNER if own else BY_SUPERVISOR), self.written_ns
        return None if by == WAITS else (by, port_owner_ns if by == BY_PORT_OWNER else 0)

    def answered_by(self, by: str, written_ns: int, latched: Stop, epoch: int) -> None:
        """Record which process wrote the stop, and when (0 if it could not be written). `latched`: the stop that was
        latched when this stop was written. `epoch`: the epoch at that time."""
        self.by = by
        self.written_ns = written_ns
        self.behind = None if latched is self else latched  # a stop that refers to itself would never be freed
        self.epoch = epoch
