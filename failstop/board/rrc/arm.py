"""The arm on the RRC: bus servos, to which the firmware writes one frame after another."""

from __future__ import annotations

from failstop.board.interface import ServoBus
from failstop.board.rrc import servos as bus
from failstop.board.servos import LONGEST_MOVE_MS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

_SUB_COMMAND_AT = 4


class RrcArm(ServoBus):
    """The arm's servos on this board. The frames are made in rrc/servos.py."""

    __slots__ = ()

    beside_wheels = holds_by_goal = False

    def stops(self, servos: Sequence[int]) -> bytes:
        """Return the frames that stop these servos. Never write them alone. Otherwise the kernel might take only a part
        of the burst before them, and the board would read them as the rest of a motor frame, with a wheel's id and
        speed. At the end of the burst's own write they follow a whole burst, or are not written at all. If they are cut
        themselves, the next burst heals the cut, as in any frame."""
        return b"".join(bus.bus_servo_stops(servos))

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """Return the frame that moves one or two servos."""
        return bus.bus_servo_move(positions, duration_ms, longest_ms or LONGEST_MOVE_MS)

    def read(self, servo: int, what: int) -> bytes:
        """Return the frame that asks one servo a question."""
        return bus.bus_servo_read(servo, what)

    def look(self, servos: Sequence[int]) -> bytes:
        """Empty, because the board can only ask one servo after another, and only while none moves."""
        return b""

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """Return the frame that switches a servo's torque on or off. When the torque is on, the servo holds its present
        position, whatever its last goal was."""
        return bus.bus_servo_torque(servo, on)

    def command(self, frame: bytes) -> int:
        """Return the sub-command in a frame."""
        return frame[_SUB_COMMAND_AT]

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """Say why a frame must not be written for these servos. Returns "" for the frames that the encoders make."""
        return bus.check_bus(frame, servos, longest_ms)

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """Return the servos that a frame moves. All of them take the time in the frame."""
        return bus.moves(frame)

    def held_ns(self, frame: bytes) -> int:
        """Return how long the servos' own bus needs for the frame, in ns."""
        return bus.held_ns(frame)
