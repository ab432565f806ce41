"""Admission: may this motion frame go to the wire? Pure; the caller brings the time and the words of shared memory.

A frame is written only when every row holds. The rows that say "stop" are causes: the port owner stops on its own and
then refuses all motion until it sees a newer epoch than the one it stopped in.

    check                                             else
    the supervisor is alive and fresh (its lease)     stop
    the gate is alive and fresh (its lease)           stop
    the frame is a whole motor frame within the speed stop
    the frame's epoch is the current one              drop: a frame of a dead epoch, wherever it was queued
    the current epoch is newer than its own stop      drop
    the frame is younger than the lease               drop

A frame that is dropped but for its speeds of zero, while the wheels may turn, is written as a burst: to stand still is
never too late.
"""

from __future__ import annotations

from failstop.board.interface import BOARD
from failstop.policy import causes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


class Admission:
    """The port owner's memory of its own stops, and its limits."""

    __slots__ = ("_lease_ns", "_max_rps", "moving", "stopped_in")

    def __init__(self, lease_ns: int, max_rps: float) -> None:
        self._lease_ns = lease_ns
        self._max_rps = max_rps
        self.stopped_in = 0
        """The newest epoch in which it stopped on its own."""
        self.moving = False
        """A motion frame has been written since the last stop."""

    def frame_fault(self, frame: bytes) -> Cause | None:
        """The cause of a stop that this frame's content is; None: it may go out."""
        fault = BOARD.check_motion(frame, self._max_rps)
        return causes.BAD_FRAME(fault) if fault else None

    def current(self, frame_epoch: int, frame_ns: int, epoch: int, now_ns: int) -> bool:
        """True when the frame is of the current epoch, after any stop of its own, and young enough."""
        return frame_epoch == epoch and epoch > self.stopped_in and now_ns - frame_ns < self._lease_ns

    def lapses_ns(self, beat_ns: int) -> int:
        """When a lease that was last renewed at `beat_ns` runs out."""
        return beat_ns + self._lease_ns

    def lapsed(self, beat_ns: int, now_ns: int) -> bool:
        """True when a lease that was last renewed at `beat_ns` has run out."""
        return now_ns - beat_ns >= self._lease_ns

    def stopped(self, epoch: int, *, own: bool) -> None:
        """A burst was written in this epoch; `own`: for a cause that the supervisor has not raised the epoch for."""
        self.moving = False
        if own:
            self.stopped_in = max(self.stopped_in, epoch)
