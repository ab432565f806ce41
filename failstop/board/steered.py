"""Steered: a described board whose base has a steering servo. The angle comes after the speeds, and its frame after
theirs."""

from __future__ import annotations

from failstop.board.described import Described

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import SteeringFrames
    from failstop.board.wire import Wire


class SteeredBoard(Described):
    """The wire's motion frame, whose length is always the same, and the steering frame behind it."""

    __slots__ = ("_steering",)

    def __init__(self, wire: Wire, per_rps: float, diameter_m: float, baud: int, steering: SteeringFrames) -> None:
        super().__init__(wire, per_rps, diameter_m, baud)
        self._steering = steering

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """Both frames. Wheels at rest are not steered, so that the frame is the stop."""
        *speeds, angle_rad = rps
        motor = super().motor_speeds(speeds, max_rps)
        return motor if motor == self.stop else motor + self._steering.frame(angle_rad)

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Both frames, or the stop."""
        motor, steers = frame[: len(self.stop)], frame[len(self.stop) :]
        if why := super().check_motion(motor, max_rps):
            return why
        return "" if motor == self.stop and not steers else self._steering.check(steers)

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """The speeds of all wheels, by the frame before the steering's."""
        return super().speeds(frame[: len(self.stop)])
