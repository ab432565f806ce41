"""The latch: of all that stops the robot, the first since the last reset is the one that people are told. Pure.

The supervisor alone latches and resets. What it publishes of it is read by everybody else.
"""

from __future__ import annotations

from failstop.policy.reply import Reply, asked_before
from failstop.shm import records
from failstop.shm.records import CAUSE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.supervisor.stops import Stop


class Latch:
    """What is latched, since which epoch; the newest stop, latched or not."""

    __slots__ = ("_raised_ns", "newest", "reset_epoch", "since", "stop")

    def __init__(self) -> None:
        self.stop: Stop | None = None
        """The one that is latched; None: nothing is."""
        self.since = 0
        """The epoch that was raised for it; 0: nothing is latched."""
        self.newest: Stop | None = None
        self.reset_epoch = 0
        """The epoch in which the last reset was made."""
        self._raised_ns = 0

    def add(self, stops: list[Stop], epoch: int, now_ns: int) -> None:
        """Stops that came together, for which the epoch is being raised to `epoch`."""
        self.newest = min(stops, key=lambda stop: stop.t_ns)
        self._raised_ns = now_ns
        if self.stop is None:
            self.stop, self.since = self.newest, epoch

    def reset(self, epoch: int, asked_ns: int) -> Reply:
        """Clear it and nothing else."""
        if self.newest and asked_ns < self._raised_ns:
            return asked_before(self.newest.cause)
        self.reset_epoch = epoch
        if self.stop is None:
            return Reply(True, "no stop is latched")
        was, self.stop, self.since = self.stop.cause, None, 0
        return Reply(True, f"latched stop cleared (was: {CAUSE}); motion still disabled", was)

    def as_record(self) -> bytes:
        """For everybody, once there was a stop."""
        told = self.stop or self.newest
        assert told is not None
        return records.LATCH.pack(self.since, told.t_ns, self._raised_ns, told.cause.pack())
