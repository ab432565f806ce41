"""Scale: compares how fast the wheels and the robot turn with what was commanded. Pure.

It uses only measurements that don't depend on board.per_rps, the scale of the commands. These are the gyro's turn
rates, and the wheels' speeds if the board reports them with its own scale. The comparison begins a moment after each
change of the command, because wheels lag. After a short comparison, only a large difference is reported.
"""

from __future__ import annotations

from math import copysign, nan

from failstop.policy import kinematics, scale

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Board
    from failstop.policy.settings import Settings

FALLEN_S = 0.6
"""After a command has become slower, nothing is compared for this long, because a wheel may still turn as fast as
before."""
BEGINS_S = 0.2
"""After a command has begun, nothing is compared for this long."""
REACHED_S = 0.3
"""A command that has stayed the same for this long counts as reached. Only then can a wheel be called too slow."""
RISEN_LEAST_S, REACHED_LEAST_S = 0.1, 0.15
"""How many seconds of motion must have been compared before a difference counts. The first value is for the sums
Ratio.risen, and the second for Ratio.reached."""
RISEN_LAG_S, REACHED_LAG_S = 0.3, 0.03
"""How much larger the allowed factor is after one compared second. After a comparison of n seconds, this is divided by
n. So after a short comparison, only a large difference counts. The first value is for the sums Ratio.risen, and the
second for Ratio.reached."""
FORGET_S = 10.0
"""When a Sum covers more than this many seconds, its values are halved. So newer motion counts more, and the comparison
follows the robot if, for example, its load changes."""
LEAST_RPS, LEAST_RADPS = 0.1, 0.1
"""Commands below these (turns per second, rad/s) are not compared with the measured motion. They are rounded coarsely,
and may be too small to start a motor."""
UNTURNED = 0.05
"""A wheel that turns at less than this share of its commanded speed is left out. It is probably unplugged or held, so
it says nothing about the scale."""
SAME = 1e-6


class Sum:
    """The commanded and the measured motion, added up over some time."""

    __slots__ = ("_measured", "_told", "seconds")

    def __init__(self) -> None:
        self._told = self._measured = self.seconds = 0.0

    def add(self, told: float, measured: float, elapsed_s: float) -> None:
        self._told += abs(told) * elapsed_s
        self._measured += copysign(1.0, told) * measured * elapsed_s
        self.seconds += elapsed_s
        if self.seconds > FORGET_S:
            self._told, self._measured, self.seconds = self._told / 2, self._measured / 2, self.seconds / 2

    @property
    def ratio(self) -> float:
        """The measured motion divided by the commanded motion. NaN if nothing was compared."""
        return self._measured / self._told if self._told else nan


class Ratio:
    """Compares measured with commanded motion, for one wheel or for the robot's turning."""

    __slots__ = ("_before", "_least", "_same_s", "_wait_s", "reached", "risen")

    def __init__(self, least: float) -> None:
        """`least`: commands smaller than this are not compared."""
        self._least = least
        self._before = self._same_s = 0.0
        self._wait_s = BEGINS_S
        self.risen, self.reached = Sum(), Sum()
        """`risen`: the sums over the time in which the command rose or stayed the same. `reached`: the sums over the
        time in which the command had been the same for REACHED_S."""

    @property
    def known(self) -> Sum:
        """The sums to judge from: those in `reached` if they cover at least REACHED_LEAST_S, otherwise those in
        `risen`."""
        return self.reached if self.reached.seconds >= REACHED_LEAST_S else self.risen

    def add(self, told: float, measured: float, elapsed_s: float) -> None:
        """Add the commanded and the measured motion of the last `elapsed_s` seconds."""
        fell = told * self._before < 0 or abs(told) < abs(self._before) - SAME
        same = abs(told - self._before) <= SAME
        self._before = told
        self._same_s = self._same_s + elapsed_s if same else 0.0
        least_s = 0.0 if told else BEGINS_S
        self._wait_s = FALLEN_S if fell else max(least_s, self._wait_s - elapsed_s)
        if self._wait_s or abs(told) < self._least:
            return
        self.risen.add(told, measured, elapsed_s)
        if self._same_s >= REACHED_S:
            self.reached.add(told, measured, elapsed_s)

    def differs(self, least: float, most: float) -> bool:
        """Return True if the ratio is certainly below `least` or above `most`. While the command rises, only `most` is
        checked, because wheels lag behind."""
        risen, reached = self.risen, self.reached
        if risen.seconds >= RISEN_LEAST_S and risen.ratio > most + RISEN_LAG_S / risen.seconds:
            return True
        if reached.seconds < REACHED_LEAST_S:
            return False
        lag = REACHED_LAG_S / reached.seconds
        return reached.ratio > most + lag or reached.ratio < 1 / (1 / least + lag)


class ScaleJudge:
    """Judges whether the measured speeds fit the commanded ones. Call update() each time the wheels are looked at."""

    def __init__(self, settings: Settings, board: Board) -> None:
        self._chassis = kinematics.from_settings(settings)
        self._layout = settings.text("wheels.layout")
        self._reports, self._per_rps = board.reports, board.per_rps
        self._wheels = [Ratio(LEAST_RPS) for _ in range(board.wheels)]
        self._turn = Ratio(LEAST_RADPS)
        self._last_ns = 0
        self.wrong: tuple[str, ...] = ()
        """Texts about what differs. Each names the setting to check."""
        self.remarks: tuple[str, ...] = ()
        """Texts about smaller differences between measured and commanded speeds. A healthy robot may have them."""

    @property
    def wheels(self) -> float:
        """The wheels' measured speed divided by the commanded one. NaN if it is not known."""
        turning = [wheel.known for wheel in self._wheels if wheel.known.ratio > UNTURNED]
        compared = sum(wheel.seconds for wheel in turning)
        return sum(wheel.ratio * wheel.seconds for wheel in turning) / compared if compared else nan

    @property
    def turn(self) -> float:
        """The robot's measured turn rate divided by the commanded one. NaN if it is not known."""
        return self._turn.known.ratio

    def update(
        self,
        velocity: tuple[float, float, float],
        speeds_rps: Sequence[float],
        read_ns: int,
        turn_radps: float | None,
        now_ns: int,
    ) -> bool:
        """Compare the commanded with the measured motion since the last call. Returns True if there is now
        something in `wrong` or in `remarks` where nothing was before, or the other way round.

        `velocity`: the commanded velocity. `speeds_rps`: the wheels' speeds by wire id, as the board reported them at
        `read_ns`. `turn_radps`: the turn rate that the gyro measures, or None while its bias is not known or it
        is silent.
        """
        elapsed_s, self._last_ns = (now_ns - self._last_ns) * 1e-9, now_ns
        if not 0 < elapsed_s < 1:
            return False
        if self._reports.own_scale and now_ns - read_ns <= 3 * self._reports.every_ns:
            told_rps = self._chassis.wheels_rps(*velocity)
            for wheel, told, measured in zip(self._wheels, told_rps, speeds_rps, strict=False):
                wheel.add(told, measured, elapsed_s)
        if turn_radps is not None:
            self._turn.add(velocity[2], turn_radps, elapsed_s)
        before = bool(self.wrong), bool(self.remarks)
        (wheels, wheels_remark), (turn, turn_remark) = self._of_wheels(), self._of_turn()
        self.wrong = tuple(filter(None, (wheels, turn)))
        self.remarks = tuple(filter(None, (wheels_remark, turn_remark)))
        return (bool(self.wrong), bool(self.remarks)) != before

    def _of_wheels(self) -> tuple[str, str]:
        """Return two texts about the wheels: what is wrong, and a remark. Each may be empty."""
        holds = self._reports.holds_speed
        turning = [wheel for wheel in self._wheels if wheel.known.ratio > UNTURNED]
        if not turning or not _all_differ(turning, scale.FITS):
            return "", ""
        wrong = ""
        if _all_differ(turning, scale.WHEELS_FIT[holds]):
            wrong = scale.wheels_differ(self.wheels, self._per_rps, holds_speed=holds)
        return wrong, "" if wrong or holds else scale.wheels_remark(self.wheels, self._per_rps)

    def _of_turn(self) -> tuple[str, str]:
        if not self._turn.differs(1 / scale.FITS, scale.FITS):
            return "", ""
        wrong = scale.gyro_differs(self.turn, self._layout) if self._turn.differs(*scale.GYRO_FITS) else ""
        return wrong, "" if wrong else scale.gyro_remark(self.turn, self._layout)


def _all_differ(wheels: Sequence[Ratio], factor: float) -> bool:
    return all(wheel.differs(1 / factor, factor) for wheel in wheels)
