"""Odometry from the wheels on a square of 20 m, each layout with the reports of each board that has them."""

from __future__ import annotations

import math
import random

import pytest

from failstop.board.hoverboard.feedback import Feedback, seal
from failstop.board.interface import WheelReports
from failstop.board.kinds import board_of
from failstop.board.wire import Wheels
from failstop.messages.records import BY_ROLLING
from failstop.policy.settings import Settings
from failstop.procs.telemetry.odometry import Odometry
from failstop.procs.telemetry.wheels import Measured
from tests.procs.telemetry.plant import Base, Report, hoverboard_word, mecanum, omni, square, two

DT_S = 0.005
S = 1_000_000_000
SIDE_M = 5.0
NOISE = 0.01
COUNTED = WheelReports(100_000_000, 0.0, 1440.0, 2.0**16, holds_speed=True, own_scale=False)
TURNS = WheelReports(100_000_000, 0.0, 1.0, 0.0, holds_speed=True, own_scale=False)


def cut(value: float) -> float:
    return float(int(value))


def ticks(base: Base) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """ros_arduino_bridge: counters."""
    return (), tuple(cut(3436 * turns) for turns in base.turns)


def rpm(base: Base) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """hoverboard-firmware-hack-FOC, as the reader of failstop's board gives it."""
    left, right = (60 * rps for rps in base.rps)
    frame = seal(0, 0, right_rpm=hoverboard_word(-right), left_rpm=hoverboard_word(left), centivolts=3600)
    (speeds,) = [sample.speeds for sample in Feedback().feed(frame) if isinstance(sample, Wheels)]
    return speeds, ()


def centimetres(base: Base) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """ugv_base_ros: what its wheels roll in whole cm, and a speed of the last ms, in which it has a count or none."""
    count_m = math.pi * 0.08 / 660
    speeds = tuple(round(rps * 0.66 + 0.3) * count_m / 0.001 for rps in base.rps)
    return speeds, tuple(cut(100 * math.pi * 0.08 * turns) for turns in base.turns)


def steps_a_second(base: Base) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Feetech's servos."""
    return tuple(cut(4096 * rps) for rps in base.rps), ()


def short_counters(base: Base) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A board of the user's own: counters of 16 bits; the right wheels' motors are mounted the other way round."""
    turns = [turns if at < len(base.turns) / 2 else -turns for at, turns in enumerate(base.turns)]
    return (), tuple((math.floor(1440 * each) + 2**15) % 2**16 - 2.0**15 for each in turns)


CASES: dict[str, tuple[dict[str, object], WheelReports | None, Report, float, float]] = {
    "differential, Arduino": ({"board.kind": "arduino"}, None, ticks, 0.2, 0.2),
    "omni3, Feetech": ({"board.kind": "feetech"}, None, steps_a_second, 0.1, 0.2),
    "mecanum, four counters": ({"odometry.sideways_scale": 1.0}, COUNTED, short_counters, 0.1, 0.2),
    "ackermann, two counters": ({"wheels.layout": "ackermann"}, COUNTED, short_counters, 0.1, 0.2),
}
COARSE: dict[str, tuple[dict[str, object], WheelReports | None, Report, float, float]] = {
    "hoverboard": (
        {"board.kind": "hoverboard", "wheels.diameter_m": 0.165, "wheels.track_m": 0.55}, None, rpm, 0.01, 0.4,
    ),
    "UGV": ({"board.kind": "ugv"}, None, centimetres, 0.05, 0.2),
}  # fmt: skip


def base_of(settings: Settings, seed: int) -> Base:
    values, layout = settings.values, settings.text("wheels.layout")
    if layout == "omni3":
        wheels = omni(float(values["wheels.lever_m"]))
    elif layout == "mecanum":
        wheels = mecanum(float(values["wheels.wheelbase_m"]), float(values["wheels.track_m"]))
    else:
        wheels = two(float(values["wheels.track_m"]))
    return Base(wheels, float(values["wheels.diameter_m"]), NOISE, seed)


class Drive:
    """A base on its square, and what odometry makes of the reports of its wheels."""

    def __init__(self, case: tuple[dict[str, object], WheelReports | None, Report, float, float], seed: int) -> None:
        changed, reports, self._report, self._every_s, self._speed_mps = case
        settings = self._settings = Settings(changed)
        self.base, self.odometry = base_of(settings, seed), Odometry(settings)
        board = board_of(settings.text("board.kind"), settings["wheels.diameter_m"], settings["board.per_rps"])
        self.measured = Measured(reports or board.reports, board.most_rps)
        self._steers = settings.text("wheels.layout") == "ackermann"
        self._ids = [int(settings[f"wheels.id_{at + 1}"]) for at in range(len(self.base.turns))]
        self.worst_m, self.t_ns = 0.0, 1 * S

    def _by_id(self, values: tuple[float, ...]) -> tuple[float, ...]:
        found = dict(zip(self._ids, values, strict=True)) if values else {}
        return tuple(found.get(id_, 0.0) for id_ in range(self._settings.speeds)) if values else ()

    def read(self) -> None:
        speeds, positions = self._report(self.base)
        self.measured.add(self._by_id(speeds), self._by_id(positions), self.t_ns)
        self.odometry.roll(self.measured)

    def square(self) -> None:
        """A steered base drives its corners as curves."""
        self.read()
        for at, way in enumerate(square(SIDE_M, self._speed_mps, 0.5, DT_S, 0.4 if self._steers else 0.0)):
            self.base.go(way, DT_S)
            self.t_ns += round(DT_S * S)
            if at % round(self._every_s / DT_S) == 0:
                self.read()
                self.worst_m = max(self.worst_m, self.off_m)
        self.read()

    @property
    def off_m(self) -> float:
        return math.hypot(self.odometry.x_m - self.base.x_m, self.odometry.y_m - self.base.y_m)

    @property
    def off_deg(self) -> float:
        return math.degrees(math.remainder(self.odometry.th_rad - self.base.th_rad, 2 * math.pi))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", list(CASES))
def test_a_square_of_20_m_stays_within_2_percent_and_ends_within_2_degrees(name: str, seed: int) -> None:
    drive = Drive(CASES[name], seed)
    drive.square()
    assert drive.odometry.source == BY_ROLLING
    assert drive.worst_m < 0.02 * 4 * SIDE_M
    assert abs(drive.off_deg) < 2.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "most_deg"), [("hoverboard", 15.0), ("UGV", 2.0 + 3.3)])
def test_coarse_reports_are_off_by_no_more_than_their_rounding(name: str, most_deg: float, seed: int) -> None:
    """Whole rpm of at most 16, and none below 5.3, are 3 % of each corner; a centimetre is 3.3 degrees."""
    drive = Drive(COARSE[name], seed)
    drive.square()
    assert abs(drive.off_deg) < most_deg
    assert abs(math.radians(drive.off_deg)) < 2 * math.sqrt(drive.odometry.covariance[5]), "and it knows"


@pytest.mark.parametrize("name", [*CASES, *COARSE])
def test_a_straight_way_is_straight(name: str) -> None:
    drive = Drive({**CASES, **COARSE}[name], 1)
    drive.read()
    for _ in range(round(10.0 / 0.2 / DT_S)):
        drive.base.go((0.2, 0.0, 0.0), DT_S)
        drive.t_ns += round(DT_S * S)
        drive.read()
    assert drive.odometry.x_m == pytest.approx(10.0, rel=0.02)
    assert abs(drive.off_deg) < 3.5


def test_the_covariance_covers_what_slips() -> None:
    """Wheels that slip by a random share of each step: over many drives the error is as large as it was told."""
    share = []
    for seed in range(40):
        settings = Settings({"board.kind": "arduino"})
        measured, odometry = Measured(TURNS), Odometry(settings)
        dice = random.Random(seed)
        true_rad, turns, rim_m, track_m = 0.0, [0.0, 0.0], math.pi * 0.08, float(settings["wheels.track_m"])
        for at in range(400):
            ways = [0.025 + dice.gauss(0.0, 0.02 * math.sqrt(0.025)) for _ in turns]
            turns = [turn + 0.025 / rim_m for turn in turns]
            true_rad += (ways[1] - ways[0]) / track_m
            measured.add((), tuple(turns), (1 + at) * S // 8)
            odometry.roll(measured)
        share.append((odometry.th_rad - true_rad) ** 2 / odometry.covariance[5])
    assert 0.5 < sum(share) / len(share) < 2.0
