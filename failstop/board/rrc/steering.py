"""Steering: the frame that turns the servo of a steered base, and a function that checks the frame before it is
written.

Steering counts as motion. The steering frame follows the motor frame in the same write, and both are accepted or
refused together. A stop leaves the steered wheels at their angle. If the servo is a bus servo, its frame holds up the
board's receiver for MOVE_NS, and delays a stop that comes right after it.
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
"""The sub-command that moves one PWM servo. failstop does not use the sub-command that moves several PWM servos,
because the firmware takes the pulse in it for the duration (firmware source)."""
TAKES_MS = 20
"""How long the servo may take to turn to its new angle, in ms. The next steering frame follows after the same time."""
LONGEST_WAY_MS = 28
_PWM_DATA, _BUS_DATA = Struct("<BHBH"), Struct("<BHBBH")
_PWM_HEAD = HEAD + bytes((PWM_SERVO, _PWM_DATA.size))
_BUS_HEAD = HEAD + bytes((BUS_SERVO, _BUS_DATA.size, SERVO_MOVE))


class Steering(ServoSteering):
    """Makes and checks the frames for one steering servo."""

    __slots__ = ()

    def frame(self, angle_rad: float) -> bytes:
        """Return the frame that steers to this angle, positive to the left. Raises FrameError if the angle is too
        large.

        The move takes TAKES_MS. If the zeros of the stop burst could complete this frame after a cut, the move takes a
        few milliseconds longer, which prevents this.
        """
        pulses = self._pulses(angle_rad)
        if self.servo.kind == BUS:
            return servos.bus_servo_move(((self.servo.id, pulses),), TAKES_MS, LONGEST_WAY_MS)
        # Each cut excludes at most one of these times, so at least one of them remains.
        every = (_PWM_DATA.pack(STEER, ms, self.servo.id, pulses) for ms in range(TAKES_MS, LONGEST_WAY_MS + 1))
        return framing.seal(PWM_SERVO, next(data for data in every if not framing.zeros_complete(PWM_SERVO, data)))

    def check(self, frame: bytes) -> str:
        """Return the reason to refuse these bytes as a steering frame, or "" to accept them. Never raises."""
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
