"""The packets that a driver may write to a VESC, and the answers that the driver gets.

A driver sets speeds in ERPM and the position of the servo, and asks for the firmware's version and for values
(RoboRacer's vesc_driver, f1tenth/vesc 01f6304; pyvesc 1.0.5). Both questions are passed on to the controller at the
port, and the answers are passed back. A new speed leaves the servo where the driver sent it before. Only a speed keeps
the wheels turning: a new position of the servo does not make the speed newer, and neither does ALIVE, which pyvesc
writes from a thread of its own, even while the program's main thread hangs. For the same reason, a speed for one motor
does not keep the other motor turning for longer than the other motor's own controller would. A brake current sets the
motor's speed to zero, and so does a duty cycle or a current of zero, also if the current is given as a share of the
largest one. Any other duty cycle or current is refused, and so is a position of the motor or a handbrake current. The
wheels then stop, because failstop can't limit the speed that would result. They also stop for a command that restarts
the controller, because a VESC releases its motor then. A packet for every controller on the CAN (id 255) counts as one
for the second motor. Bytes that are not a packet are skipped as the firmware skips them.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.facts import USUAL_CAN_ID
from failstop.board.vesc import codec

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

PATIENCE_NS = 1_000_000_000
MOTOR_NS = 1_000_000_000
"""A motor that the driver has not commanded for this long, in ns, gets speed zero. It is the time after which a
controller releases its motor, unless somebody has changed it in VESC Tool."""
_VALUE, _PLACE = Struct(">i"), Struct(">h")
_VERSION, _VALUES, _CURRENT, _BRAKE, _POSITION, _HANDBRAKE, _ALIVE, _CURRENT_SHARE = 0, 4, 6, 7, 9, 10, 30, 84
_EVERY_CAN_ID = 255
_PASSED_ON = frozenset((_VERSION, _VALUES))
_NO_PACKET = DriverRefusal(
    "bytes that are not a packet", "the board skips them too: is the driver made for this board?"
)
_SILENT_MOTOR = DriverRefusal(
    "the last speed of one motor", "the driver has not commanded it for 1 s, so it was stopped: does a thread hang?"
)
_NO_SPEED = {
    codec.DUTY: "a duty cycle",
    _CURRENT: "a current",
    _POSITION: "a position of the motor",
    _HANDBRAKE: "a handbrake current",
    _CURRENT_SHARE: "a share of the current",
}
_ZERO_STOPS = frozenset((codec.DUTY, _CURRENT, _CURRENT_SHARE))
"""The motor stops or is released if the value of one of these commands is zero."""
_RESTARTS = {1: "a jump to the boot loader", 29: "a reboot"}


class VescDriver:
    """Reads the packets that one driver program writes to the guard port, and returns the answers to its questions."""

    def __init__(self, can_id: int | None, steering: tuple[float, float] | None) -> None:
        """`can_id` is the CAN id of the second motor, or None for a single motor. For a steered base, `steering` is
        (the servo's pulse for straight ahead, the change of the pulse for one radian to the left), both in us.
        Otherwise it is None."""
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, 0
        self._can_id, self._steering = can_id, steering
        self._speeds = [0.0] if can_id is None else [0.0, 0.0]
        self._commanded_ns = [0] * len(self._speeds)
        """The time of the driver's newest command for each motor, in ns."""
        self._silent: set[int] = set()
        """The motors that were stopped because the driver had not commanded them. It has not ended driving, so if it
        dies, that counts as the death of a driver."""
        self._angle_rad: float | None = None if steering is None else 0.0
        self._wrote = self._heard = b""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        data = self._wrote + chunk
        found = list(codec.pieces(data))
        self._wrote = data[sum(size for _, size in found) :]
        rows = [row for payload, _ in found if payload for row in self._asked(payload, 0, now_ns)]
        if not all(payload for payload, _ in found):
            rows.append(_NO_PACKET)
        return rows

    def resume(self, before: VescDriver) -> None:
        """Continue the conversation `before` with the same driver. A driver may write the servo's position only when it
        changes."""
        self._wrote = before._wrote
        if self._steering and before._steering:
            self._angle_rad = before._angle_rad

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Return the answers to the driver's questions, in whole packets. The answers to failstop's own questions are
        not returned."""
        found, self._heard = codec.payloads(self._heard + chunk)
        return [codec.packet(payload) for payload in found if payload[0] in _PASSED_ON]

    def _asked(self, payload: bytes, motor: int, now_ns: int) -> list[Row]:
        command, data = payload[0], payload[1:]
        if command == codec.FORWARD and not motor:
            if self._can_id is None or len(data) < 2 or data[0] not in (self._can_id, _EVERY_CAN_ID):
                where = f"a packet for CAN id {data[0]}" if data else "a packet for the CAN"
                known = "no motor on a CAN" if self._can_id is None else f"one on id {self._can_id} (board.can_id)"
                return [DriverRefusal(where, f"failstop's settings have {known}")]
            return self._asked(data[1:], 1, now_ns)
        if command in _PASSED_ON:
            if motor:
                return [DriverRefusal("a question for the second VESC", "failstop asks it itself, and passes none on")]
            question = codec.FIRMWARE if command == _VERSION else codec.VALUES
            return [DriverFrame(question, str(command), asks=True)]
        if command == codec.SERVO:
            return self._steer(data)
        if command == _ALIVE:
            return []
        if command == _BRAKE:
            return self._set(motor, 0.0, now_ns)
        if command in (codec.RPM, *_NO_SPEED) and len(data) >= _VALUE.size:
            (value,) = _VALUE.unpack_from(data)
            if command == codec.RPM:
                return self._set(motor, float(value), now_ns)
            if not value and command in _ZERO_STOPS:
                return self._set(motor, 0.0, now_ns)
            why = "its speed can't be limited, so the wheels were stopped: use a speed (SetRPM)"
            return [DriverRefusal(_NO_SPEED[command], why), *self._stopped()]
        if command in _RESTARTS:
            why = "failstop restarts no controller, so the wheels were stopped: do it while no service runs"
            return [DriverRefusal(_RESTARTS[command], why), *self._stopped()]
        return [DriverRefusal(f"command {command}", "failstop passes on no settings, tests or other questions")]

    def _set(self, motor: int, erpm: float, now_ns: int) -> list[Row]:
        self._speeds[motor], self._commanded_ns[motor] = erpm, now_ns
        self._silent.discard(motor)
        for other, commanded_ns in enumerate(self._commanded_ns):
            if self._speeds[other] and now_ns - commanded_ns >= MOTOR_NS:
                self._speeds[other] = 0.0
                self._silent.add(other)
        motion = self._motion(refused=bool(self._silent))
        return [_SILENT_MOTOR, motion] if self._silent else [motion]

    def _motion(self, *, renews: bool = True, refused: bool = False) -> DriverMotion:
        return DriverMotion(tuple(self._speeds), refused=refused, steering_rad=self._angle_rad, renews=renews)

    def _stopped(self) -> list[Row]:
        self._speeds = [0.0] * len(self._speeds)
        self._silent.clear()
        return [self._motion(refused=True)]

    def _steer(self, data: bytes) -> list[Row]:
        if self._steering is None:
            return [DriverRefusal("the servo", 'failstop steers a base with wheels.layout = "ackermann" alone')]
        if len(data) < _PLACE.size:
            return []
        centre, per_rad = self._steering
        (place,) = _PLACE.unpack_from(data)
        self._angle_rad = (max(0, min(place, codec.WAY_US)) + codec.FIRST_US - centre) / per_rad
        return [self._motion(renews=False)] if any(self._speeds) else []


def language(settings: Mapping[str, float | str]) -> VescDriver:
    """Make a VescDriver, with the wheels and the servo that the settings describe."""
    if settings.get("wheels.layout") != "ackermann":
        return VescDriver(int(settings.get("board.can_id", USUAL_CAN_ID)), None)
    per_rad = float(settings["steering.sign"]) * float(settings["steering.per_rad"])
    return VescDriver(None, (float(settings["steering.centre"]), per_rad))
