"""The RRC as a Board: its four wheels, its arm, its gamepad and its keys. codec.py, servos.py and decoder.py of this
folder make and read its frames, and burst.py has its stop burst."""

from __future__ import annotations

from struct import Struct

from failstop.board import plausible
from failstop.board.interface import (
    BY_ANSWER,
    BY_IMU,
    HEARD_KEY,
    HEARD_PAD,
    HEARD_PONG,
    HEARD_SERVO,
    NO_WHEEL_REPORTS,
    Board,
    Hearing,
)
from failstop.board.rrc import codec, decoder, framing
from failstop.board.rrc.arm import RrcArm
from failstop.board.rrc.burst import BURST, FIRST_STOP_END
from failstop.board.rrc.steering import Steering
from failstop.board.steered import SteeringMixin
from failstop.board.wire import Commander, Port

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from failstop.board.facts import SteeringServo
    from failstop.board.interface import Said

RRC_PORT = Port(baud=1_000_000, dtr=True, rts=False, deaf_ns=0, opening=())
_REPEATS_NS = (20_000_000, 100_000_000)
_SPEEDS = Struct(f"<6x{'Bf' * framing.WHEELS}")


def _imu(data: bytes) -> list[Said]:
    sample = decoder.imu(data)
    return [] if sample is None else plausible.imu_said(sample)


def _battery(data: bytes) -> list[Said]:
    millivolts = decoder.battery_mv(data)
    return [] if millivolts is None else plausible.battery_said(millivolts / 1000)


def _pad(data: bytes) -> list[Said]:
    sample = decoder.gamepad(data)
    return [(HEARD_PAD, (*sample, data))] if sample else []


def _key(data: bytes) -> list[Said]:
    pressed = decoder.key(data)
    return [(HEARD_KEY, pressed)] if pressed else []


def _servo(data: bytes) -> list[Said]:
    answer = decoder.servo_reply(framing.BUS_SERVO, data)
    return [(HEARD_SERVO, answer)] if answer else []


def _pong(data: bytes) -> list[Said]:
    index = decoder.pong(data)
    return [] if index is None else [(HEARD_PONG, (index,))]


_SAID: dict[int, Callable[[bytes], list[Said]]] = {
    framing.IMU_FUNC: _imu,
    framing.SYS: _battery,
    framing.GAMEPAD: _pad,
    framing.KEY_FUNC: _key,
    framing.BUS_SERVO: _servo,
    framing.PWM_SERVO: _pong,
}
"""For each kind of frame, the function that makes its reports. The function returns no reports if the frame makes no
sense.

A ping asks for the position of a PWM servo. Its answer names the servo, and so shows which ping it answers. If a client
of failstop asks for the position of the same servo, its question has the same bytes as the ping. So failstop treats the
question as a ping too: the port owner records it, and its answer also proves that the board hears.
"""


class FrameHearing(Hearing):
    """Decodes the board's frames into reports."""

    __slots__ = ("_decoder",)

    def __init__(self) -> None:
        self._decoder = decoder.Decoder()

    def feed(self, chunk: bytes) -> list[Said]:
        """Return all reports in the frames that these bytes complete."""
        found: list[Said] = []
        for func, data in self._decoder.feed(chunk):
            if said := _SAID.get(func):
                found += said(data)
        return found

    def reset(self) -> None:
        """Forget an incomplete frame."""
        self._decoder.reset()


class Rrc(Board):
    """The RRC as a Board, made of the constants and functions of the other modules in this folder."""

    __slots__ = ()

    name = "the STM32 controller of Hiwonder's robots"
    port = RRC_PORT
    idle_ns = after_ns = 0
    repeats_ns = (_REPEATS_NS, _REPEATS_NS, ())
    """The times at which the port owner, the stopper and the supervisor repeat their stops, in ns after the first stop
    of each. Two of them may have the same times, because this board accepts stops that follow each other without a gap.
    The supervisor repeats no stop, because the stopper repeats its own stops."""
    stop = codec.STOP
    burst = BURST
    first_stop = BURST[:FIRST_STOP_END]
    refresh = codec.STOP
    pings = tuple(codec.pwm_servo_read(servo) for servo in (1, 2, 3, 4))
    ping_ns = 0
    echo_ns = fades_ns = 0
    silent_ns = 600_000_000
    """How long the IMU's reports must pause before the board counts as restarted, in ns. A busy computer or adapter
    causes only shorter pauses."""
    arming = b""
    acknowledged_by = BY_ANSWER
    observed_by = BY_IMU
    reports = NO_WHEEL_REPORTS
    # The unit is turns per second, because the board's firmware knows the encoders of its motors.
    per_rps = 1.0
    wheels = framing.WHEELS
    most_rps = codec.RPS_CEILING
    step_rps = 0.0
    usb = ("1a86:55d4",)
    usb_alone = True
    arm: RrcArm = RrcArm()
    commanders = (
        Commander(
            who="a gamepad at the board, or Bluetooth: with some firmware it drives the robot without this computer",
            remedy="switch that off in the firmware, or unplug and unpair what you don't drive with",
        ),
        Commander(
            who="the vendor's ROS node writes to the board, and failstop checks nothing that it writes",
            remedy="the vendor's service starts it at boot (on some robots start_node.service, in a container)",
            program="lib/ros_robot_controller/",
            fix="sudo systemctl disable --now start_app_node.service",
        ),
    )

    def hearing(self) -> Hearing:
        """Return a new decoder for the board's frames."""
        return FrameHearing()

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """Return the frame that sets all four wheels."""
        return codec.motor_speeds(rps, max_rps)

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Return the reason to refuse these bytes as a frame for four wheels, or "" to accept them."""
        return codec.check_motion(frame, max_rps)

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """Return the wheels' speeds in a frame for four wheels, in the order of the wire ids. A wheel that the frame
        does not name counts as 0. None for other bytes."""
        if not frame.startswith(framing.MOTOR_HEAD) or len(frame) < _SPEEDS.size:
            return None
        found = _SPEEDS.unpack_from(frame)
        by_id = dict(zip(found[::2], found[1::2], strict=True))
        return [by_id.get(wire_id, 0.0) for wire_id in range(framing.WHEELS)]

    def buzzer(self, freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
        """Return the frame that sounds the buzzer."""
        return codec.buzzer(freq_hz, on_ms, off_ms, repeat)

    def check_aux(self, frame: bytes) -> str:
        """Say why these bytes must not be written as a frame for the buzzer. Returns "" if they may be written."""
        return codec.check_aux(frame)


class SteeredRrc(SteeringMixin, Rrc):
    """The RRC of a base that has a steering servo."""

    __slots__ = ("_steering",)

    def __init__(self, servo: SteeringServo) -> None:
        self._steering = Steering(servo)


BOARD = Rrc()


def board(_diameter_m: float, _per_rps: float, steering: SteeringServo | None) -> Board:
    """Make the board. It needs no diameter and no scale, because its speeds are in turns per second."""
    return SteeredRrc(steering) if steering else BOARD
