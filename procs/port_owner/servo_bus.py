"""ServoBus: may this frame go to the arm's servos now? Pure; the caller brings the time.

A frame is written only when every row holds, after the rows of admission.py (epoch, age, leases).

    check                                                    else
    the robot has an arm, and the frame is a whole one for   stop
      its servos within bounds (BOARD.check_servos)
    no motion frame was written since the last stop          drop: an arm moves while the wheels stand
    a question: nothing is before it, no servo moves         drop: a silent servo holds the receiver for 5 ms
    the receiver is held for less than HELD_NS by what is    wait: it is what a stop may have to wait; those behind it
      before it and itself                                   wait too, until they are too old

A move that waits is late by a millisecond or two. Dropped, its joints would stand until the next one, a period later.
"""

from __future__ import annotations

from collections import deque

from failstop.board.interface import BOARD
from failstop.board.servos import HELD_NS, LONGEST_MOVE_MS, MOVE, READS
from failstop.policy import causes
from failstop.procs.loop import NEVER

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause
    from failstop.procs.port_owner.admission import Motion

LONGEST_MOVE_NS = LONGEST_MOVE_MS * 1_000_000
_COMMAND_AT = 4
MOST_WAITING = 16


class ServoBus:
    """When the servos' bus is free, as far as this process has written to it."""

    __slots__ = ("_free_ns", "_rest_ns", "servos", "waiting")

    def __init__(self, servos: tuple[int, ...]) -> None:
        self.servos = servos
        self._free_ns = 0
        self._rest_ns = 0
        self.waiting: deque[Motion] = deque(maxlen=MOST_WAITING)
        """The gate's frames for the servos that are not yet written, in order; every stop ends them."""

    def check(self, frame: bytes) -> Cause | None:
        """The cause of a stop that this frame's content is; None: it may go out."""
        fault = "this robot has no arm"
        if self.servos:
            fault = BOARD.check_servos(frame, self.servos, LONGEST_MOVE_MS)
        return causes.BAD_FRAME(f"for the arm, {fault}") if fault else None

    def due_ns(self, frame: bytes, now_ns: int, *, wheels_move: bool) -> int:
        """When a frame without a fault may be written, now or soon; NEVER: it is dropped."""
        if wheels_move:
            return NEVER
        if frame[_COMMAND_AT] in READS:
            return now_ns if now_ns >= max(self._free_ns, self._rest_ns) else NEVER
        return max(now_ns, self._free_ns + BOARD.servo_ns(frame) - HELD_NS)

    def wrote(self, frame: bytes, now_ns: int) -> bool:
        """It was written; True when a servo moves by it."""
        self._free_ns = max(self._free_ns, now_ns) + BOARD.servo_ns(frame)
        moves = frame[_COMMAND_AT] == MOVE
        if moves:
            self._rest_ns = now_ns + LONGEST_MOVE_NS
        return moves
