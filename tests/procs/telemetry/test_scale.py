"""How the measured speeds compare with the told ones: what is said of a scale that is wrong, and what is not."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from itertools import product
from math import isnan, nan

import pytest

from failstop.board.kinds import board_of
from failstop.policy import scale
from failstop.policy.settings import Settings
from failstop.procs.telemetry.scale import ScaleJudge

STEP_NS = 20_000_000
OWN = ("hoverboard", "ugv")
"""Boards that report in a unit of their own."""
WRONG = (0.2, 0.4, 2.5, 6.0)
"""Wrong scales that no slope, load or battery explains."""
NEAR = (0.5, 0.7, 1.5, 2.0)
"""Those that it may explain where the board sets a voltage."""
DRIVE_S = 1.0
"""What `failstop drive` drives for by default."""


class Robot:
    """Wheels and a body behind a judge: they lag, and turn `wheels` and `body` times as fast as told."""

    def __init__(self, kind: str, *, wheels: float = 1.0, body: float | None = None, lag_s: float = 0.06) -> None:
        self.settings = Settings({"board.kind": kind})
        self.board = board_of(*self.settings.board())
        self.judge = ScaleJudge(self.settings, self.board)
        self.now_ns = 10**9
        self._wheels, self._body, self._lag_s = wheels, body, lag_s
        self._speeds = [0.0] * self.board.wheels
        self._turn = 0.0
        self.told = self.velocity = (0.0, 0.0, 0.0)
        self.said: list[str] = []
        self.remarked: list[str] = []
        self.noise: Callable[[], float] = float
        self.reports = True
        self._read_ns = 0

    def drive(self, vx: float, wz: float, seconds: float) -> None:
        """Toward this velocity by the ramps of the settings."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.now_ns += STEP_NS
            step_s = STEP_NS / 1e9
            ramps = 0.5 * step_s, 2.0 * step_s
            now_vx, _, now_wz = self.velocity
            near = [
                max(now - most, min(now + most, to))
                for now, to, most in ((now_vx, vx, ramps[0]), (now_wz, wz, ramps[1]))
            ]
            self.velocity = (near[0] if vx else 0.0, 0.0, near[1] if wz else 0.0)
            wanted = self.judge._chassis.wheels_rps(*self.velocity)
            share = min(1.0, step_s / self._lag_s)
            for id_, rps in enumerate(wanted):
                self._speeds[id_] += share * (self._wheels * rps - self._speeds[id_])
            if self._body is not None:
                self._turn += share * (self._body * self.velocity[2] - self._turn)
            if self.reports:
                self._read_ns = self.now_ns
            gyro = None if self._body is None else self._turn + self.noise() / 50
            measured = [speed + self.noise() for speed in self._speeds]
            if self.judge.update(self.velocity, measured, self._read_ns, gyro, self.now_ns):
                self.said += [text for text in self.judge.wrong if _kind_of(text) not in map(_kind_of, self.said)]
                self.remarked += self.judge.remarks


def _kind_of(text: str) -> str:
    """What differs: the wheels or the turn."""
    return text.partition(" turn")[0]


@pytest.mark.parametrize(("kind", "ratio"), [*product(OWN, WRONG), *product(("ugv",), NEAR)])
def test_the_first_drive_tells_wheels_that_do_not_turn_as_told(kind: str, ratio: float) -> None:
    robot = Robot(kind, wheels=ratio)
    robot.drive(0.2, 0.0, DRIVE_S)
    robot.drive(0.0, 0.0, 1.0)
    (said,) = robot.said
    assert "times as fast as they are told, as the board reports them" in said
    would = float(said.partition("board.per_rps = ")[2].partition(" ")[0])
    assert would == pytest.approx(robot.board.per_rps / ratio, rel=0.3)
    robot.drive(0.2, 0.0, 5.0)
    assert robot.judge.wheels == pytest.approx(ratio, rel=0.05)
    assert len(robot.said) == 1, "once"


@pytest.mark.parametrize("ratio", NEAR)
def test_the_first_drive_remarks_on_what_a_slope_or_a_load_may_explain(ratio: float) -> None:
    robot = Robot("hoverboard", wheels=ratio)
    robot.drive(0.2, 0.0, DRIVE_S)
    robot.drive(0.0, 0.0, 1.0)
    assert robot.said == []
    assert "a slope, a load or the battery can do that, but if they always do, board.per_rps = " in robot.remarked[-1]
    would = float(robot.remarked[-1].partition("board.per_rps = ")[2].partition(" ")[0])
    assert would == pytest.approx(robot.board.per_rps / ratio, rel=0.15)


@pytest.mark.parametrize("ratio", [0.2, 0.4, 0.5, 1.5, 2.0, 2.5, 6.0])
def test_the_gyro_tells_a_turn_that_is_not_as_told(ratio: float) -> None:
    robot = Robot("rrc", body=ratio)
    robot.drive(0.0, 1.0, DRIVE_S)
    robot.drive(0.0, 0.0, 1.0)
    (said,) = robot.said
    assert "as the gyro measures it: one of wheels.track_m, wheels.diameter_m" in said


@pytest.mark.parametrize("ratio", [-0.2, -0.7, -1.0, -1.5])
def test_the_gyro_tells_a_turn_the_wrong_way(ratio: float) -> None:
    """Its sides are swapped, or the IMU is upside down."""
    robot = Robot("rrc", body=ratio)
    robot.drive(0.0, 1.0, DRIVE_S)
    robot.drive(0.0, 0.0, 1.0)
    (said,) = robot.said
    assert said.startswith("the robot turns the wrong way, as the gyro measures it: its wheels are swapped (wheels.id")
    assert robot.remarked == []


def test_a_turn_that_skidding_wheels_explain_is_a_remark() -> None:
    robot = Robot("rrc", body=0.7)
    robot.drive(0.0, 1.0, DRIVE_S)
    assert robot.said == []
    assert "tracks and skidding wheels do that, but otherwise one of wheels.track_m" in robot.remarked[-1]


@pytest.mark.parametrize("kind", ["arduino", "feetech", "vesc"])
def test_reports_that_share_the_scale_say_nothing_of_it(kind: str) -> None:
    robot = Robot(kind, wheels=5.0)
    robot.drive(0.1, 0.0, 5.0)
    assert robot.said == []
    assert isnan(robot.judge.wheels)


def test_a_robot_on_a_stand_is_not_told_to_turn_too_slowly() -> None:
    robot = Robot("rrc", body=0.0)
    robot.drive(0.0, 1.0, 5.0)
    assert robot.said == []


def test_wheels_that_stand_or_are_not_reported_are_no_scale() -> None:
    for robot in (Robot("ugv", wheels=0.0), Robot("ugv", wheels=5.0)):
        robot.reports = robot._wheels == 0.0
        robot.drive(0.2, 0.0, 5.0)
        assert robot.said == []
        assert isnan(robot.judge.wheels) or robot.judge.wheels < scale.ON_A_STAND


@pytest.mark.parametrize("kind", [*OWN, "rrc"])
def test_ramps_reversals_lag_and_noise_are_no_wrong_scale(kind: str) -> None:
    """Plants of each kind whose lag and load are drawn: an open loop is slower uphill and faster downhill."""
    for seed in range(60):
        chance = random.Random(f"{kind} {seed}")
        holds = kind != "hoverboard"
        wheels = chance.uniform(0.95, 1.05) if holds else chance.uniform(0.6, 1.6)
        robot = Robot(kind, wheels=wheels, body=chance.uniform(0.75, 1.1), lag_s=chance.uniform(0.02, 0.25))
        robot.noise = partial(chance.gauss, 0.0, 0.02)
        for _ in range(40):
            forward, turn = chance.choice([0.0, 0.1, 0.2, -0.2]), chance.choice([0.0, 0.0, 0.5, -1.0])
            robot.drive(forward, turn, chance.uniform(0.1, 2.0))
        assert robot.said == [], f"{kind} {seed}"


def test_differences_are_words_only_where_they_are_known() -> None:
    assert scale.wheels_differ(nan, 60.0, holds_speed=True) == ""
    assert scale.wheels_differ(0.0, 60.0, holds_speed=True) == ""
    assert scale.wheels_differ(1.2, 60.0, holds_speed=True) == ""
    assert "board.per_rps = 40 would fit it (now 60)" in scale.wheels_differ(1.5, 60.0, holds_speed=True)
    assert scale.wheels_differ(1.5, 60.0, holds_speed=False) == ""
    assert scale.gyro_differs(0.05, "mecanum") == scale.gyro_differs(nan, "mecanum") == ""
    assert "wheels.lever_m" in scale.gyro_differs(2.0, "omni3")
    assert scale.gyro_differs(-0.09, "mecanum") == ""
    assert "steering.sign or" in scale.gyro_differs(-1.0, "ackermann")
