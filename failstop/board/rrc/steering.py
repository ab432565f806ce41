"""Steering: the frame that turns the servo of a steered base, and its check before it is written.

It is part of the same write as the motor frame before it, because steering is motion: it is admitted and refused as
motion is. A stop has no such frame, and leaves the wheels at their angle. The frame for a bus servo holds the board's
receiver for MOVE_NS, so a stop right after it is that much later.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.rrc import framing, servos
from failstop.board.rrc.framing import BUS_SERVO, HEAD, PWM_SERVO, crc8
from failstop.board.servos import SERVO_MOVE
from failstop.board.steered import ServoSteering

TYPE_CHECKING = False
if TYPE_CHECKING:
    pass

PWM, BUS = "pwm", "bus"
STEER = 3
"""Sub-command for one PWM servo. The one for several takes the pulse for the time (firmware source), and is not
used."""
TAKES_MS = 20
"""The servo's time for a move, which is the time until the next frame."""
LONGEST_WAY_MS = 28
_PWM_DATA, _BUS_DATA = Struct("<BHBH"), Struct("<BHBBH")
_PWM_HEAD = HEAD + bytes((PWM_SERVO, _PWM_DATA.size))
_BUS_HEAD = HEAD + bytes((BUS_SERVO, _BUS_DATA.size, SERVO_MOVE))


class Steering(ServoSteering):
    """The frames of one steering servo."""

    __slots__ = ()

    def frame(self, angle_rad: float) -> bytes:
        """The frame for this angle to the left. Raises FrameError for a larger angle than allowed.

        The servo's time may be a few milliseconds longer, so that no frame is made that the zeros of the stop burst
        could complete if it were cut short.
        """
        pulses = self._pulses(angle_rad)
        if self.servo.kind == BUS:
            return servos.bus_servo_move(((self.servo.id, pulses),), TAKES_MS, LONGEST_WAY_MS)
        # Each cut excludes at most one of these times, so one of this many is left.
        every = (_PWM_DATA.pack(STEER, ms, self.servo.id, pulses) for ms in range(TAKES_MS, LONGEST_WAY_MS + 1))
        return framing.seal(PWM_SERVO, next(data for data in every if not framing.zeros_complete(PWM_SERVO, data)))

    def check(self, frame: bytes) -> str:
        """Why these bytes must not be written to steer; "" if they may. Never raises on bytes."""
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
