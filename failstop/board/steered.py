"""Steering: a board whose base has a steering servo. In a motion frame, the angle comes after the speeds."""

from __future__ import annotations

from failstop.board import checks
from failstop.board.interface import Board, SteeringFrames

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.facts import SteeringServo


class SteeringMixin(Board):
    """Adds steering to a class of boards. Inherit from this class first, then from the board's class. A motion frame is
    then the wheels' frame, which always has the same length, followed by the steering frame."""

    __slots__ = ()

    _steering: SteeringFrames

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """Return the wheels' frame, followed by the steering frame. `rps` has the wheels' speeds, then the steering
        angle in radians. If all wheels are at rest, the result is exactly the stop, without a steering frame."""
        *speeds, angle_rad = rps
        motor = super().motor_speeds(speeds, max_rps)
        return motor if motor == self.stop else motor + self._steering.frame(angle_rad)

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Return the reason to refuse these bytes, or "" to accept them. It accepts a wheels' frame with a steering
        frame, or the stop alone."""
        motor, steers = frame[: len(self.stop)], frame[len(self.stop) :]
        if why := super().check_motion(motor, max_rps):
            return why
        return "" if motor == self.stop and not steers else self._steering.check(steers)

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """Return the speeds of all wheels. The steering frame after them is ignored."""
        return super().speeds(frame[: len(self.stop)])


class ServoSteering(SteeringFrames):
    """The frames for a steering servo that is commanded in pulses. `servo` has the pulses for straight ahead, and the
    pulses per radian."""

    __slots__ = ("_limit", "servo")

    def __init__(self, servo: SteeringServo) -> None:
        self.servo = servo
        self._limit = servo.most_rad * (1 + 2.0**-40)
        """The largest angle, with an allowance for rounding errors."""

    def _pulses(self, angle_rad: float) -> int:
        """Return the pulses for this angle, positive to the left. Raises FrameError if the angle is larger than
        allowed."""
        angle = checks.number("steering angle", angle_rad, -self._limit, self._limit, "rad")
        return self.servo.centre + round(angle * self.servo.per_rad)

    def _beyond(self, pulses: int) -> str:
        """Say why the servo must not get these pulses. Returns "" if it may get them."""
        beyond = abs(pulses - self.servo.centre) > abs(self._limit * self.servo.per_rad) + 1
        return f"steering at {pulses}, straight ahead is {self.servo.centre}" if beyond else ""
