"""Parts that a robot has or lacks, on every screen: a steered axle, an IMU."""

from __future__ import annotations

from math import radians

import pytest

from failstop.policy.settings import Settings
from tests.support.simulated import Simulated

NO_IMU = "not observed: the robot has no IMU"


def drive(robot: Simulated, vx: float, wz: float) -> None:
    robot.enable()
    robot.drive(0.8, (vx, 0.0, wz))


@pytest.mark.parametrize(("vx", "wz", "side"), [(0.2, 0.3, "left"), (0.2, -0.3, "right"), (-0.2, 0.3, "right")])
def test_a_steered_base_tells_the_angle_that_is_commanded(vx: float, wz: float, side: str) -> None:
    """Positive turns the wheels to the left; backward that turns the robot to the right."""
    robot = Simulated({"wheels.layout": "ackermann"})
    drive(robot, vx, wz)
    state = robot.robot.state
    assert state.steering_rad == pytest.approx(radians(15) if side == "left" else -radians(15), abs=radians(1))
    assert f"steering  15 degrees to the {side}" in robot.command("status")[1]
    assert robot.load("failstop.web.view").live(state, None)[5] == f"15 degrees to the {side}"
    robot.drive(0.4, (vx, 0.0, 0.0))
    assert robot.robot.state.steering_rad == 0.0
    robot.robot.disable()
    assert robot.robot.state.steering_rad is None


def test_what_is_not_steered_has_no_angle() -> None:
    robot = Simulated()
    drive(robot, 0.2, 0.3)
    assert (robot.robot.state.moving, robot.robot.state.steering_rad) == (True, None)


def test_a_robot_without_an_imu_says_so_and_waits_for_none() -> None:
    robot = Simulated({"board.imu": "off"}, imu_hz=0.0)
    drive(robot, 0.2, 0.0)
    robot.robot.estop("enough")
    robot.wait_for("its outcome", lambda: NO_IMU in robot.said, 1.0)
    assert "bias" not in robot.said
    assert NO_IMU in robot.printed("status")
    assert "no IMU" in robot.printed("status").partition("sensor")[2]
    assert robot.json("why")["proof"].endswith(NO_IMU)
    shown = robot.load("failstop.web.view").view(robot.robot.state, [], 0.0)
    assert (shown["imu"], shown["stop"]["observed"], shown["stop"]["unseen"]) == (False, "", "no IMU")


@pytest.mark.parametrize(("kind", "imu"), [("arduino", False), ("hoverboard", False), ("ugv", True)])
def test_of_each_board_it_is_known(kind: str, imu: bool) -> None:
    assert Settings({"board.kind": kind}).on("board.imu") is imu
