"""Admission: decides whether a motion frame, or a frame for the arm's servos, may be written to the board. Pure: the
caller passes the time and the words of shared memory.

For a motion frame, the checks are made in this order, and the first one that fails decides:

    check                                                    if it fails
    the port owner watches a gate, so the gate is alive      DROP
    the frame has the current epoch                          DROP: it is from before a stop
    the current epoch is newer than the last stop that the   DROP: the supervisor has not answered that stop yet
      port owner made by itself
    the frame is younger than the lease                      DROP
    no stop request waits                                    STOP_ASKED: stop for that request
    the gate has beaten within its lease                     stop with a cause
    the supervisor has beaten within its lease               stop with a cause
    it is a whole motor frame, no faster than allowed        stop with a cause
    (no check has failed)                                    ADMIT: write it

The port owner stops by itself if it is the first to notice a cause. After that, it refuses all motion until a newer
epoch. A zero-speed frame is not dropped while the wheels may turn. It gets STAND_STILL instead, and the port owner
writes a stop.

For a frame for the servos, the same checks are made, except the last one. Then these are made:

    check                                                    if it fails
    the robot has an arm, and the frame is a whole one for   stop with a cause
      its servos within their bounds (ServoBus.check)
    no motion frame was written since the last stop, or      drop it: this arm moves only while the wheels are stopped
      this board's arm may move while the wheels do
    if the frame asks a servo something: no earlier frame    drop it: a servo that does not answer blocks the receiver
      still blocks the receiver, and no servo moves. (Moving   for 5 ms
      servos don't matter if this board's arm may move while
      the wheels do.)
    the frame and those before it block the receiver for     wait, so that a stop never has to wait longer. Later
      at most HELD_NS                                          frames wait too, and are dropped when they are too old

While the board's receiver passes a frame on to the servos, all later frames wait for it, even a stop. A servo move may
wait one or two milliseconds. It must not be dropped, because its joints would stop for one period.

Before a motion frame is written, these invariants are checked too, from facts that the checks above don't use. A broken
invariant stops the robot (DEFECT):

    the epoch only grows (checked whenever it changes)
    only one process writes the port owner's memory
    no stop is latched in the current epoch, or in an earlier one
    the frame was made after the last stop that the port owner made by itself
"""

from __future__ import annotations

from collections import deque

from failstop.board.interface import Board, ServoBus
from failstop.board.servos import HELD_NS, LONGEST_MOVE_MS, LONGEST_MOVE_NS, READS, SERVO_MOVE
from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import MS, NEVER

ADMIT, DROP, STAND_STILL, STOP_ASKED = range(4)
DatedFrame = tuple[bytes, int, int]
"""A frame from the gate, the epoch that it carries, and when the gate made it (CLOCK_MONOTONIC, ns)."""
MOST_WAITING = 16


class Admission:
    """Decides whether a motion frame may be written, and remembers the stops that the port owner made by itself."""

    def __init__(self, board: Board, lease_ns: int, max_rps: float) -> None:
        self._board = board
        self._lease_ns = lease_ns
        self._max_rps = max_rps
        self.stopped_in = 0
        """The newest epoch in which the port owner has stopped by itself; 0 if it has not."""
        self._stopped_ns = 0
        """The time when the port owner last stopped by itself."""
        self.wheels_move = False
        """True if a motion frame was written since the last stop."""

    def decide(
        self,
        motion: DatedFrame,
        epoch: int,
        now_ns: int,
        gate_ns: int | None,
        supervisor_ns: int,
        rules: Admission | BusSchedule,
        *,
        requested: bool,
    ) -> int | Cause:
        """Decide about one frame. Returns ADMIT, DROP, STAND_STILL or STOP_ASKED, or the cause of a stop.

        `gate_ns` and `supervisor_ns`: when each of these processes last beat; None for a gate that is not being
        watched. `rules`: checks the content of the frame. `requested`: True if a stop request waits.
        """
        if gate_ns is None or not self.current(motion, epoch, now_ns):
            return STAND_STILL if self.wheels_move and motion[0] == self._board.stop else DROP
        if requested:
            return STOP_ASKED
        if lapse := self.lapsed(gate_ns, supervisor_ns, now_ns):
            return lapse
        return rules.check(motion[0]) or ADMIT

    def check(self, frame: bytes) -> Cause | None:
        """Return the cause of a stop if this motion frame must not be written, or None if it may be."""
        fault = self._board.check_motion(frame, self._max_rps)
        return None if fault == "" else causes.BAD_FRAME(_said(fault))

    def current(self, motion: DatedFrame, epoch: int, now_ns: int) -> bool:
        """Return True if the frame belongs to the current epoch, the port owner has not stopped by itself in that
        epoch, and the frame is young enough."""
        _, frame_epoch, frame_ns = motion
        return frame_epoch == epoch and epoch > self.stopped_in and now_ns - frame_ns < self._lease_ns

    def lapses_ns(self, gate_ns: int, supervisor_ns: int) -> int:
        """Return the time when the first of the two leases ends. `gate_ns` and `supervisor_ns`: when these processes
        last beat."""
        return min(gate_ns, supervisor_ns) + self._lease_ns

    def lapsed(self, gate_ns: int, supervisor_ns: int, now_ns: int) -> Cause | None:
        """Return the cause of a stop if one of the two leases has ended, or None if both hold."""
        for name, beat_ns in ((layout.GATE, gate_ns), (layout.SUPERVISOR, supervisor_ns)):
            if now_ns - beat_ns >= self._lease_ns:
                return causes.HANGS(name, (now_ns - beat_ns) // MS)
        return None

    def stopped(self, epoch: int, now_ns: int) -> None:
        """Record that the port owner stopped by itself in this epoch. The supervisor will answer with a newer epoch."""
        self.wheels_move = False
        self.stopped_in = max(self.stopped_in, epoch)
        self._stopped_ns = now_ns

    def follow(self, epoch: int, before: int) -> Cause | None:
        """Handle a change of the epoch. A higher epoch means that there was a stop. A lower epoch is a defect: the
        cause of a stop is returned, and from now on motion is admitted only in an epoch that is higher than every
        earlier one."""
        if epoch > before:
            return None
        self.stopped_in = max(self.stopped_in, before)
        return causes.DEFECT(layout.SUPERVISOR, f"epoch {epoch}", f"{before} was in force")

    def impossible(self, frame_ns: int, epoch: int, latched_in: int, *, alone: bool) -> Cause | None:
        """Return the cause of a stop if an admitted motion frame breaks an invariant, or None if all invariants hold.
        `latched_in`: the epoch of the latched stop, or 0 if no stop is latched. `alone`: True if no other process
        writes the port owner's memory."""
        if not alone:
            return causes.DEFECT(layout.PORT_OWNER, "motion", "another process writes its memory")
        if 0 < latched_in <= epoch:
            return causes.DEFECT(layout.GATE, "motion", "a stop is latched")
        return causes.DEFECT(layout.GATE, "motion", "a stop is newer") if frame_ns < self._stopped_ns else None


class BusSchedule:
    """Computes when the servos' bus is free, from the written frames, and keeps the frames that wait for it."""

    def __init__(self, bus: ServoBus | None, servos: tuple[int, ...]) -> None:
        """`bus`: the servos of the board's arm. `servos`: the ids of the robot's servos; empty for a robot without an
        arm."""
        self._bus = bus
        self.servos = servos
        self._free_ns = 0
        self._rest_ns = 0
        self.waiting: deque[DatedFrame] = deque(maxlen=MOST_WAITING)
        """The frames for the servos that the gate has sent and that are not written yet, in order. Every stop drops
        them."""

    def check(self, frame: bytes) -> Cause | None:
        """Return the cause of a stop if this frame for the servos must not be written, or None if it may be."""
        fault = "this robot has no arm"
        if self._bus and self.servos:
            fault = self._bus.check(frame, self.servos, LONGEST_MOVE_MS)
        return None if fault == "" else causes.BAD_FRAME(f"for the arm, {_said(fault)}")

    def due_ns(self, frame: bytes, now_ns: int, *, wheels_move: bool) -> int:
        """Return the time when a frame that has passed check() may be written, or NEVER if it must be dropped."""
        bus = self._bus
        if bus is None or (wheels_move and not bus.beside_wheels):
            return NEVER
        if bus.command(frame) in READS:
            rest_ns = 0 if bus.beside_wheels else self._rest_ns
            return now_ns if now_ns >= max(self._free_ns, rest_ns) else NEVER
        return max(now_ns, self._free_ns + bus.held_ns(frame) - HELD_NS)

    def wrote(self, frame: bytes, now_ns: int) -> bool:
        """Record that a frame was written. Returns True if the frame moves a servo."""
        if self._bus is None:
            return False
        self._free_ns = max(self._free_ns, now_ns) + self._bus.held_ns(frame)
        moves = self._bus.command(frame) == SERVO_MOVE
        if moves:
            self._rest_ns = now_ns + LONGEST_MOVE_NS
        return moves


def _said(fault: object) -> str:
    """Return the fault that a check has found, as text. A result that is not a text, such as None, is reported as a
    fault too."""
    return fault if fault and isinstance(fault, str) else f"its check returned {fault!r}, not a text"
