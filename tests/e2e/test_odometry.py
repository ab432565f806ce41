"""The whole service on the simulated machine: what it says of its way is what the wheels of the board have turned."""

from __future__ import annotations

import math

import pytest

from tests.support.simulated import Simulated

REPORTING = ("arduino", "damiao", "feetech", "hoverboard", "ugv", "vesc")
LOOK_S = 0.002


class Judge:
    """What the wheels behind the receiver have turned, by its own speeds."""

    def __init__(self, simulated: Simulated) -> None:
        self._simulated = simulated
        self.turns: list[float] = []
        self._ns = simulated.now_ns()

    def look(self) -> None:
        now_ns = self._simulated.now_ns()
        rps = self._simulated.lab.board.model.wheels
        self.turns = self.turns or [0.0] * len(rps)
        self.turns = [turn + each * (now_ns - self._ns) / 1e9 for turn, each in zip(self.turns, rps, strict=True)]
        self._ns = now_ns


@pytest.mark.parametrize("kind", REPORTING)
def test_the_way_that_is_told_is_the_way_of_the_wheels(kind: str) -> None:
    simulated = Simulated(kind=kind)
    judge = Judge(simulated)
    simulated.enable()
    simulated.drive(1.0, (0.1, 0.0, 0.0), judge.look)
    for _ in range(500):
        simulated.wait(LOOK_S)
        judge.look()
    state = simulated.robot.state
    assert state.odometry.source == "wheels"
    rim_m = math.pi * float(simulated.robot.settings["wheels.diameter_m"])
    if kind == "feetech":
        left, _, right = (rim_m * turns for turns in judge.turns)
        forward_m = (right - left) / 2 / math.cos(math.radians(30.0))
    else:
        signs = [int(simulated.robot.settings[f"wheels.sign_{at}"]) for at in (1, 2)]
        forward_m = sum(sign * turns for sign, turns in zip(signs, judge.turns, strict=True)) / 2 * rim_m
    assert forward_m > 0.05
    assert state.odometry.x_m == pytest.approx(forward_m, abs=0.011)
    assert abs(state.odometry.y_m) < 0.02
    assert state.turning.turned_rad is not None
    assert state.odometry.pose_variance < 0.1


def test_a_board_that_reports_nothing_says_that_its_odometry_is_what_was_commanded() -> None:
    simulated = Simulated()
    simulated.enable()
    simulated.drive(0.5)
    found = simulated.robot.state.odometry
    assert found.source == "commands"
    assert found.x_m > 0.01
    assert found.pose_variance == 1e3


def test_wheels_that_do_not_turn_make_no_way() -> None:
    """Told to drive for a second, while the board hears nothing."""
    simulated = Simulated(kind="hoverboard")
    simulated.enable()
    simulated.drive(0.1, (0.1, 0.0, 0.0))
    simulated.robot.disable()
    simulated.wait(1.0)
    before = simulated.robot.state.odometry
    simulated.board.deaf(True)
    simulated.enable()
    simulated.drive(1.0, (0.1, 0.0, 0.0))
    now = simulated.robot.state.odometry
    assert (now.x_m, now.vx_mps) == (before.x_m, 0.0)
