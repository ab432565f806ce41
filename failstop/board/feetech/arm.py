"""The arm on the wheels' bus: servos in position mode, which count 4096 steps per turn.

A stop writes nothing to the arm's servos: a servo without a new goal stays at its last goal, with its torque on. An arm
moves by a stream of goals, each at most one period (arm.period_s) ahead. No frame of this module addresses a wheel.
Only frames that set positions, switch torques or read pass FeetechArm.check().
"""

from __future__ import annotations

from failstop.board import servos as bus
from failstop.board.checks import FrameError, counted, distinct, integer
from failstop.board.feetech import codec
from failstop.board.interface import ServoBus

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from failstop.board.wire import Port

HIGHEST = codec.TURN - 1
ANSWER_NS = 1_000_000
"""How long a servo takes to answer, with its default return delay, in ns."""
_ROWS_AT = 7


def _id(servo: int) -> int:
    if servo in codec.WHEELS:
        raise FrameError(f"servo id is {servo}, must be none of the wheels'")
    return integer("servo id", servo, 1, bus.HIGHEST_ID)


def _goals(positions: Sequence[tuple[int, int]]) -> bytes:
    counted("moves", positions, 1, bus.MOST_MOVES)
    distinct("servo id", [servo for servo, _ in positions])
    rows = (bytes((_id(servo),)) + integer("position", at, 0, HIGHEST).to_bytes(2, "little") for servo, at in positions)
    return codec.sync_write(codec.GOAL_POSITION, 2, b"".join(rows))


def _rows(frame: bytes) -> list[tuple[int, int]]:
    """Return the goals in a frame: (id, position) for each servo."""
    rows = frame[_ROWS_AT : frame[3] + 3]
    return [(rows[at], rows[at + 1] | rows[at + 2] << 8) for at in range(0, len(rows), 3)]


def _torque(servo: int, on: bool) -> bytes:
    return codec.sync_write(codec.TORQUE_SWITCH, 1, bytes((_id(servo), on)))


class FeetechArm(ServoBus):
    """Makes and checks the frames for the arm's servos on the wheels' bus."""

    __slots__ = ("_byte_ns",)

    beside_wheels = holds_by_goal = True

    def __init__(self, port: Port) -> None:
        self._byte_ns = port.byte_ns

    def stops(self, servos: Sequence[int]) -> bytes:
        """Return no bytes, because a servo that gets no new goal stays at its last goal, with its torque on."""
        return b""

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """Return one frame with a new goal for each of these servos. `duration_ms` and `longest_ms` are ignored,
        because a servo goes to its goal as fast as it can, and the goal is only a small step away."""
        return _goals(positions)

    def read(self, servo: int, what: int) -> bytes:
        """Return the packet that asks one servo a question."""
        return codec.packet(_id(servo), codec.READ, bytes(codec.READS[what]))

    def look(self, servos: Sequence[int]) -> bytes:
        """Return the packet that asks one to three servos for their positions at once (a sync read). Raises FrameError
        for more than three servos. A question to the wheels asks three too."""
        counted("servos", servos, 1, len(codec.WHEELS))
        distinct("servo id", servos)
        ids = bytes([_id(servo) for servo in servos])
        return codec.packet(codec.EVERY_SERVO, codec.SYNC_READ, bytes(codec.READS[bus.POSITION]) + ids)

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """Return the packets that switch a servo's torque on or off. Before the torque is switched on, the servo's
        present position becomes its goal, so that it does not jump."""
        return (_goals([(servo, max(0, min(at, HIGHEST)))]) if on else b"") + _torque(servo, on)

    def command(self, frame: bytes) -> int:
        """Return the command in a frame. The address that the frame reads or writes shows which command it is."""
        if frame[4] in (codec.READ, codec.SYNC_READ):
            return next(what for what, asked in codec.READS.items() if bytes(asked) == frame[5:7])
        if frame[5] == codec.TORQUE_SWITCH:
            return bus.TORQUE_OFF
        return bus.SERVO_MOVE if len(frame) == frame[3] + 4 else bus.TORQUE_ON

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """Say why a frame must not be written. Returns "" if this class makes exactly these bytes from the frame's
        fields, and all servos in the frame are among `servos`."""
        try:
            ids, made = self._made_again(frame)
        except (ValueError, IndexError, StopIteration):  # a FrameError is a ValueError
            return "no frame for an arm's servos"
        if made != frame:
            return "not as this board's frames for an arm are written"
        return next((f"servo {servo} is none of the arm's" for servo in ids if servo not in servos), "")

    def _made_again(self, frame: bytes) -> tuple[list[int], bytes]:
        """Return the servos in a frame, and the frame that this class itself makes from the same fields."""
        if frame[4] == codec.READ:
            return [frame[2]], self.read(frame[2], self.command(frame))
        if frame[4] == codec.SYNC_READ:
            looked = list(frame[_ROWS_AT:-1])
            return looked, self.look(looked)
        if frame[5] == codec.TORQUE_SWITCH:
            return [frame[_ROWS_AT]], _torque(frame[_ROWS_AT], False)
        moves = _rows(frame)
        ids = [servo for servo, _ in moves]
        if self.command(frame) == bus.TORQUE_ON:
            ((servo, at),) = moves[:1]
            return ids, self.torque(servo, True, at)
        return ids, _goals(moves)

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """Return the goals in a frame as (id, position, duration). The duration is always 0, because a servo moves to
        its goal as fast as it can."""
        try:
            goals = _rows(frame)
            return [(servo, at, 0) for servo, at in goals] if frame == _goals(goals) else []
        except (ValueError, IndexError):  # a FrameError is a ValueError
            return []

    def held_ns(self, frame: bytes) -> int:
        """Return how long the servos take to answer a question, in ns. For any other frame, return its own time on the
        line."""
        asked = {codec.READ: 1, codec.SYNC_READ: len(frame) - _ROWS_AT - 1}.get(frame[4], 0)
        return asked * ANSWER_NS or len(frame) * self._byte_ns
