"""The arm on the RRC: bus servos that the firmware talks to, one frame after another."""

from __future__ import annotations

from failstop.board.interface import ServoBus
from failstop.board.rrc import servos as bus
from failstop.board.servos import LONGEST_MOVE_MS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

_SUB_COMMAND_AT = 4


class RrcArm(ServoBus):
    """The arm's servos on this board. Its frames are in rrc/servos.py."""

    __slots__ = ()

    beside_wheels = holds_by_goal = False

    def stops(self, servos: Sequence[int]) -> bytes:
        """A stop for each servo. It is never a write of its own: if the kernel took only a part of the burst before it,
        the board would read it as the rest of a motor frame, as a wheel's id and speed. At the end of the burst's own
        write it follows a whole burst or is not written at all, and the next burst heals a cut in it as in any
        frame."""
        return b"".join(bus.bus_servo_stops(servos))

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """The frame that moves one or two servos."""
        return bus.bus_servo_move(positions, duration_ms, longest_ms or LONGEST_MOVE_MS)

    def read(self, servo: int, what: int) -> bytes:
        """The frame that asks one servo a question."""
        return bus.bus_servo_read(servo, what)

    def look(self, servos: Sequence[int]) -> bytes:
        """Empty, because the board asks one servo after another, and only while none moves."""
        return b""

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """The frame that switches a servo's torque. The servo then holds its present position, whatever its last goal
        was."""
        return bus.bus_servo_torque(servo, on)

    def command(self, frame: bytes) -> int:
        """The sub-command in a frame."""
        return frame[_SUB_COMMAND_AT]

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """The fault in a frame for the servos; only frames that the encoders make pass."""
        return bus.check_bus(frame, servos, longest_ms)

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """The servos that a frame moves. All of them take the time in the frame."""
        return bus.moves(frame)

    def held_ns(self, frame: bytes) -> int:
        """How long the servos' own bus needs for the frame."""
        return bus.held_ns(frame)
