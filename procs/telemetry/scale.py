"""Scale: how fast the wheels turn, and the robot turns, beside what they are told. Pure.

It compares only where the measurement is independent of the command: reports in a unit of their own, and the gyro. A
wheel that speeds up lags behind, so what is compared begins a moment after the command last fell, and the less of it
there is, the further off it must be before anybody is told.
"""

from __future__ import annotations

from math import copysign, nan

from failstop.policy import kinematics, scale

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Board
    from failstop.policy.settings import Settings

SETTLES_S = 0.2
"""After a command has fallen, or has changed its sign, nothing is compared for so long."""
FAST_S, SLOW_S = 0.1, 0.6
"""How much has to be compared before it is called too fast, or too slow: a motor needs a moment to begin."""
LAG_S = 0.3
"""Added to the factor that still fits, divided by the seconds that were compared."""
FORGET_S = 10.0
"""Half of it is forgotten then, so that what is known follows the robot."""
LEAST_RPS, LEAST_RADPS = 0.1, 0.1
"""A slower command is not compared: it is rounded, and a motor may not begin to turn."""
STANDS = 0.05
"""Wheels that make less of their speed stand: unplugged, or held."""


class Ratio:
    """Measured over told, of one wheel or of the turn."""

    __slots__ = ("_least", "_measured", "_settled_s", "_told", "_told_before", "seconds")

    def __init__(self, least: float) -> None:
        """`least`: a smaller command is not compared."""
        self._least = least
        self._told_before = self._settled_s = 0.0
        self._told = self._measured = self.seconds = 0.0

    @property
    def value(self) -> float:
        """NaN: nothing was compared."""
        return self._measured / self._told if self._told else nan

    def add(self, told: float, measured: float, elapsed_s: float) -> None:
        """What was told and measured in this time."""
        falls = told * self._told_before <= 0 or abs(told) < abs(self._told_before)
        self._told_before = told
        self._settled_s = 0.0 if falls else self._settled_s + elapsed_s
        if self._settled_s < SETTLES_S or abs(told) < self._least:
            return
        self._told += abs(told) * elapsed_s
        self._measured += copysign(1.0, told) * measured * elapsed_s
        self.seconds += elapsed_s
        if self.seconds > FORGET_S:
            self._told, self._measured, self.seconds = self._told / 2, self._measured / 2, self.seconds / 2

    def differs(self, factor: float) -> bool:
        """Whether it is known to be off by more than this factor."""
        if self.seconds < (FAST_S if self.value > 1 else SLOW_S):
            return False
        return not scale.fits(self.value, factor + LAG_S / self.seconds)


class ScaleJudge:
    """`follow` once for each look at the wheels."""

    def __init__(self, settings: Settings, board: Board) -> None:
        self._chassis = kinematics.from_settings(settings)
        self._layout = settings.text("wheels.layout")
        self._reports, self._per_rps = board.reports, board.per_rps
        self._wheels = [Ratio(LEAST_RPS) for _ in range(board.wheels)]
        self._turn = Ratio(LEAST_RADPS)
        self._last_ns = 0
        self.wrong: tuple[str, ...] = ()
        """What differs, in words, with the setting to look at."""

    @property
    def wheels(self) -> float:
        """How fast the wheels turn beside what they are told; NaN: not known."""
        turning = [wheel for wheel in self._wheels if wheel.value > STANDS]
        compared = sum(wheel.seconds for wheel in turning)
        return sum(wheel.value * wheel.seconds for wheel in turning) / compared if compared else nan

    @property
    def turn(self) -> float:
        """The same of the robot's turn; NaN: not known."""
        return self._turn.value

    def follow(
        self,
        velocity: tuple[float, float, float],
        speeds_rps: Sequence[float],
        read_ns: int,
        turn_radps: float | None,
        now_ns: int,
    ) -> bool:
        """Compare since the last look; True when `wrong` has changed. `velocity` is told; `speeds_rps`: as the board
        reported at `read_ns`, by wire id; `turn_radps`: as the gyro feels it, None while its bias is not known."""
        elapsed_s, self._last_ns = (now_ns - self._last_ns) * 1e-9, now_ns
        if not 0 < elapsed_s < 1:
            return False
        if self._reports.own_scale and now_ns - read_ns <= 3 * self._reports.every_ns:
            told_rps = self._chassis.wheels_rps(*velocity)
            for wheel, told, measured in zip(self._wheels, told_rps, speeds_rps, strict=False):
                wheel.add(told, measured, elapsed_s)
        if turn_radps is not None:
            self._turn.add(velocity[2], turn_radps, elapsed_s)
        before, self.wrong = self.wrong, tuple(filter(None, (self._of_wheels(), self._of_turn())))
        return bool(self.wrong) != bool(before)

    def _of_wheels(self) -> str:
        holds = self._reports.holds_speed
        turning = [wheel for wheel in self._wheels if wheel.value > STANDS]
        if not turning or not all(wheel.differs(scale.WHEELS_FIT[holds]) for wheel in turning):
            return ""
        return scale.wheels_differ(self.wheels, self._per_rps, holds_speed=holds)

    def _of_turn(self) -> str:
        if not self._turn.differs(scale.GYRO_FITS):
            return ""
        return scale.gyro_differs(self._turn.value, self._layout)
