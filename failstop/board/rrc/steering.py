"""Steering: the frame that turns the PWM servo of a steered base, and the check of it before the wire.

It goes out in one write with the motor frame before it: steering is motion, admitted and refused as motion is. A stop
has no such frame, and leaves the wheels turned as they are.
"""

from __future__ import annotations

from struct import Struct

from failstop.board import framing
from failstop.board.framing import HEAD, PWM_SERVO, crc8
from failstop.data import Data

MOVE = 3
"""Sub-command: one servo. That for many takes the pulse for the time (firmware source), and is not used."""
TAKES_MS = 20
"""The servo's time for a way: as long as until the next frame."""
_LONGER_MS = 8
_DATA = Struct("<BHBH")
_FRAME_HEAD = HEAD + bytes((PWM_SERVO, _DATA.size))
SIZE = len(_FRAME_HEAD) + _DATA.size + 1


class Steering(Data):
    """The servo, its pulse for straight ahead, more pulse for an angle to the left, and the largest angle."""

    servo: int
    centre_us: int
    us_per_rad: float
    most_rad: float

    def frame(self, angle_rad: float) -> bytes:
        """The frame for this angle to the left. Raises FrameError for one beyond the largest.

        The servo's time may be some milliseconds longer: no frame is made that the zeros of the stop burst could
        complete, were it cut short.
        """
        framing.number("steering angle", angle_rad, -self._limit, self._limit, "rad")
        pulse_us = self.centre_us + round(angle_rad * self.us_per_rad)
        # Each cut excludes one of these times at most, so that one of so many is left.
        every = (_DATA.pack(MOVE, TAKES_MS + more, self.servo, pulse_us) for more in range(_LONGER_MS))
        return framing.seal(PWM_SERVO, next(data for data in every if not framing.zeros_complete(PWM_SERVO, data)))

    def check(self, frame: bytes) -> str:
        """Why these bytes must not be written to steer; "" when they may. Never raises on bytes."""
        if len(frame) != SIZE or not frame.startswith(_FRAME_HEAD):
            return "not a steering frame"
        if crc8(frame[2:]):
            return "bad crc"
        command, ms, servo, pulse_us = _DATA.unpack_from(frame, len(_FRAME_HEAD))
        if (command, servo) != (MOVE, self.servo) or not TAKES_MS <= ms < TAKES_MS + _LONGER_MS:
            return f"another servo's frame ({command} {servo} {ms})"
        if abs(pulse_us - self.centre_us) > abs(self._limit * self.us_per_rad) + 1:
            return f"steering at {pulse_us} us, centre {self.centre_us}"
        if end := framing.zeros_complete(PWM_SERVO, frame[4:-1]):
            return f"another angle if cut after {end} bytes of data"
        return ""

    @property
    def _limit(self) -> float:
        """The largest angle, and what arithmetic may add to it."""
        return self.most_rad * (1 + 2.0**-40)
