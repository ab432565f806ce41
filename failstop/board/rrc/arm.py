"""The arm on the RRC: bus servos. The firmware writes to them one after another."""

from __future__ import annotations

from failstop.board.interface import ServoBus
from failstop.board.rrc import servos as bus
from failstop.board.servos import LONGEST_MOVE_MS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

_SUB_COMMAND_AT = 4


class RrcArm(ServoBus):
    """Makes and checks the frames for the arm's servos, with the functions of rrc/servos.py."""

    __slots__ = ()

    beside_wheels = holds_by_goal = False

    def stops(self, servos: Sequence[int]) -> bytes:
        """Return the frames that stop these servos. Always append them to the stop burst, and write both in one write,
        so that they never follow a cut burst. After a cut burst, the board could read their bytes as the rest of a
        motor frame, and take some of them for a wheel's id and speed. If one of these frames is cut short, the next
        burst makes it harmless."""
        return b"".join(bus.bus_servo_stops(servos))

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """Return the frame that moves one or two servos. A `longest_ms` of 0 means LONGEST_MOVE_MS."""
        return bus.bus_servo_move(positions, duration_ms, longest_ms or LONGEST_MOVE_MS)

    def read(self, servo: int, what: int) -> bytes:
        """Return the frame that asks one servo a question."""
        return bus.bus_servo_read(servo, what)

    def look(self, servos: Sequence[int]) -> bytes:
        """Return no bytes, because this board can ask only one servo at a time, and only while no servo moves."""
        return b""

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """Return the frame that switches a servo's torque on or off. Once the torque is on, the servo holds its present
        position, whatever its last goal was. So `at` is not used."""
        return bus.bus_servo_torque(servo, on)

    def command(self, frame: bytes) -> int:
        """Return the sub-command in a frame."""
        return frame[_SUB_COMMAND_AT]

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """Return the reason to refuse this frame for these servos, or "" to accept it. Only frames that the encoders
        make are accepted."""
        return bus.check_bus(frame, servos, longest_ms)

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """Return (id, position, duration in ns) for each servo that a frame moves. All durations are equal."""
        return bus.moves(frame)

    def held_ns(self, frame: bytes) -> int:
        """Return the longest time that the servos' own bus needs for this frame, in ns."""
        return bus.held_ns(frame)
