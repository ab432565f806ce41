"""ServoBus: may this frame go to the arm's servos now? Pure; the caller brings the time.

A frame is written only when every row holds, after the rows of admission.py (epoch, age, leases).

    check                                                    else
    the robot has an arm, and the frame is a whole one for   stop
      its servos within bounds (BOARD.check_servos)
    no motion frame was written since the last stop          drop: an arm moves while the wheels stand
    the receiver is held for less than HELD_NS by what is    drop: it is what a stop may have to wait
      before it and itself
    a question: nothing is before it, no servo moves         drop: a silent servo holds the receiver for 5 ms
"""

from __future__ import annotations

from failstop.board.interface import BOARD
from failstop.board.servos import HELD_NS, LONGEST_MOVE_MS, MOVE, READS
from failstop.policy import causes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause

LONGEST_MOVE_NS = LONGEST_MOVE_MS * 1_000_000
_COMMAND_AT = 4


class ServoBus:
    """When the servos' bus is free, as far as this process has written to it."""

    __slots__ = ("_free_ns", "_rest_ns", "servos")

    def __init__(self, servos: tuple[int, ...]) -> None:
        self.servos = servos
        self._free_ns = 0
        self._rest_ns = 0

    def check(self, frame: bytes) -> Cause | None:
        """The cause of a stop that this frame's content is; None: it may go out."""
        fault = "this robot has no arm"
        if self.servos:
            fault = BOARD.check_servos(frame, self.servos, LONGEST_MOVE_MS)
        return causes.BAD_FRAME(f"for the arm, {fault}") if fault else None

    def admits(self, frame: bytes, now_ns: int, *, wheels_move: bool) -> bool:
        """True when a frame without a fault may be written now."""
        before_ns = max(0, self._free_ns - now_ns)
        if wheels_move:
            return False
        if frame[_COMMAND_AT] in READS:
            return not before_ns and now_ns >= self._rest_ns
        return before_ns + BOARD.servo_ns(frame) <= HELD_NS

    def wrote(self, frame: bytes, now_ns: int) -> bool:
        """It was written; True when a servo moves by it."""
        self._free_ns = max(self._free_ns, now_ns) + BOARD.servo_ns(frame)
        moves = frame[_COMMAND_AT] == MOVE
        if moves:
            self._rest_ns = now_ns + LONGEST_MOVE_NS
        return moves
