"""Steering: the frame that turns the servo of a steered base, and the check of it before the wire.

It goes out in one write with the motor frame before it: steering is motion, admitted and refused as motion is. A stop
has no such frame, and leaves the wheels turned as they are. The frame for a bus servo holds the board's receiver for
MOVE_NS: a stop right behind it comes so much later.
"""

from __future__ import annotations

from struct import Struct

from failstop.board import checks
from failstop.board.rrc import framing, servos
from failstop.board.rrc.framing import BUS_SERVO, HEAD, PWM_SERVO, crc8
from failstop.board.servos import SERVO_MOVE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.facts import SteeringServo

PWM, BUS = "pwm", "bus"
STEER = 3
"""Sub-command: one PWM servo. That for many takes the pulse for the time (firmware source), and is not used."""
TAKES_MS = 20
"""The servo's time for a way: as long as until the next frame."""
LONGEST_WAY_MS = 28
_PWM_DATA, _BUS_DATA = Struct("<BHBH"), Struct("<BHBBH")
_PWM_HEAD = HEAD + bytes((PWM_SERVO, _PWM_DATA.size))
_BUS_HEAD = HEAD + bytes((BUS_SERVO, _BUS_DATA.size, SERVO_MOVE))


class Steering:
    """The frames of one steering servo."""

    __slots__ = ("_limit", "servo")

    def __init__(self, servo: SteeringServo) -> None:
        self.servo = servo
        self._limit = servo.most_rad * (1 + 2.0**-40)
        """The largest angle, and what arithmetic may add to it."""

    def frame(self, angle_rad: float) -> bytes:
        """The frame for this angle to the left. Raises FrameError for one beyond the largest.

        The servo's time may be some milliseconds longer: no frame is made that the zeros of the stop burst could
        complete, were it cut short.
        """
        checks.number("steering angle", angle_rad, -self._limit, self._limit, "rad")
        pulses = self.servo.centre + round(angle_rad * self.servo.per_rad)
        if self.servo.kind == BUS:
            return servos.bus_servo_move(((self.servo.id, pulses),), TAKES_MS, LONGEST_WAY_MS)
        # Each cut excludes one of these times at most, so that one of so many is left.
        every = (_PWM_DATA.pack(STEER, ms, self.servo.id, pulses) for ms in range(TAKES_MS, LONGEST_WAY_MS + 1))
        return framing.seal(PWM_SERVO, next(data for data in every if not framing.zeros_complete(PWM_SERVO, data)))

    def check(self, frame: bytes) -> str:
        """Why these bytes must not be written to steer; "" when they may. Never raises on bytes."""
        if self.servo.kind == BUS:
            if not frame.startswith(_BUS_HEAD):
                return "not a steering frame"
            if why := servos.check_bus(frame, (self.servo.id,), LONGEST_WAY_MS):
                return why
            *_, pulses = _BUS_DATA.unpack_from(frame, 4)
            return self._beyond(pulses)
        if len(frame) != len(_PWM_HEAD) + _PWM_DATA.size + 1 or not frame.startswith(_PWM_HEAD):
            return "not a steering frame"
        if crc8(frame[2:]):
            return "bad crc"
        command, ms, servo, pulses = _PWM_DATA.unpack_from(frame, len(_PWM_HEAD))
        if (command, servo) != (STEER, self.servo.id) or not TAKES_MS <= ms <= LONGEST_WAY_MS:
            return f"another servo's frame ({command} {servo} {ms})"
        if end := framing.zeros_complete(PWM_SERVO, frame[4:-1]):
            return f"another angle if cut after {end} bytes of data"
        return self._beyond(pulses)

    def _beyond(self, pulses: int) -> str:
        beyond = abs(pulses - self.servo.centre) > abs(self._limit * self.servo.per_rad) + 1
        return f"steering at {pulses}, straight ahead is {self.servo.centre}" if beyond else ""
