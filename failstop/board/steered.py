"""Steering: a board whose base has a steering servo. The angle follows the speeds, and its frame follows the frame of
the speeds."""

from __future__ import annotations

from failstop.board import checks
from failstop.board.interface import Board, SteeringFrames

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.facts import SteeringServo


class SteeringMixin(Board):
    """Makes a class of boards steer; inherit from it first. A motion frame of such a board is the frame for the wheels,
    which always has the same length, followed by the frame for the steering."""

    __slots__ = ()

    _steering: SteeringFrames

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """The frame for the wheels, then the frame for the steering. Wheels at rest are not steered, so that their
        frame is the stop."""
        *speeds, angle_rad = rps
        motor = super().motor_speeds(speeds, max_rps)
        return motor if motor == self.stop else motor + self._steering.frame(angle_rad)

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Why these bytes must not be written; "" if they are both frames, or the stop."""
        motor, steers = frame[: len(self.stop)], frame[len(self.stop) :]
        if why := super().check_motion(motor, max_rps):
            return why
        return "" if motor == self.stop and not steers else self._steering.check(steers)

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """The speeds of all wheels, from the frame before the steering frame."""
        return super().speeds(frame[: len(self.stop)])


class ServoSteering(SteeringFrames):
    """A servo whose position is commanded in pulses. `servo` has the pulses for straight ahead, and the pulses per
    radian."""

    __slots__ = ("_limit", "servo")

    def __init__(self, servo: SteeringServo) -> None:
        self.servo = servo
        self._limit = servo.most_rad * (1 + 2.0**-40)
        """The largest angle, plus rounding errors."""

    def _pulses(self, angle_rad: float) -> int:
        """The pulses for this angle (positive to the left). Raises FrameError if the angle is larger than allowed."""
        angle = checks.number("steering angle", angle_rad, -self._limit, self._limit, "rad")
        return self.servo.centre + round(angle * self.servo.per_rad)

    def _beyond(self, pulses: int) -> str:
        """Why the servo must not get these pulses; "" if it may."""
        beyond = abs(pulses - self.servo.centre) > abs(self._limit * self.servo.per_rad) + 1
        return f"steering at {pulses}, straight ahead is {self.servo.centre}" if beyond else ""
