"""The plugin's robot on a service: the simulated board says what moved."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
from lerobot.cameras import CameraConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_failstop import Failstop, FailstopConfig, RobotStopped

from failstop_lab.faults.arm import ArmTrial
from failstop_lab.trial import wait_for

from .scene import CALIBRATION, JOINTS, RANGES, until

AT = {"shoulder_pan": 600, "shoulder_lift": 650, "elbow_flex": 100, "gripper": 450}
"""Pulses of AIMS, by hand: 300 + 3/4 of 400; inverted 800 - 1/4 of 600; 100; 400 + 1/4 of 200."""
AIMS = {"arm_shoulder_pan.pos": 50.0, "arm_shoulder_lift.pos": -50.0, "arm_elbow_flex.pos": -100.0}
AIMS["arm_gripper.pos"] = 25.0
STILL = dict.fromkeys(("x.vel", "y.vel", "theta.vel"), 0.0)


@pytest.fixture
def make(trial: ArmTrial, tmp_path: Path) -> Iterator[Any]:
    """Makes robots of that service, with the calibration, and disconnects them."""
    (tmp_path / "kiwi.json").write_text(json.dumps(CALIBRATION))
    made: list[Failstop] = []

    def one(**given: Any) -> Failstop:
        known = {"id": "kiwi", "calibration_dir": tmp_path, "service": trial.name, "joints": JOINTS}
        made.append(Failstop(FailstopConfig(**{**known, **given})))
        return made[-1]

    yield one
    for robot in made:
        if robot.is_connected:
            robot.disconnect()


def near(trial: ArmTrial, wanted: dict[str, int]) -> bool:
    at = trial.board.joints()
    return all(abs(at[RANGES[name][0]] - pulses) <= 2 for name, pulses in wanted.items())


def test_the_arm_follows_in_the_numbers_of_the_calibration(trial: ArmTrial, make: Any) -> None:
    robot = make(cameras={"front": CameraConfig(fps=30, width=4, height=2)})
    robot.connect()
    for name in AT:
        trial.board.servo(RANGES[name][0], position=500)
    robot.send_action(STILL)
    trial.robot.arm.read()

    def there() -> bool:
        assert robot.send_action({**AIMS, **STILL}) == pytest.approx({**AIMS, **STILL})
        return near(trial, AT)

    until(there)
    seen = robot.get_observation()
    assert list(seen) == list(robot.observation_features)
    assert {name: seen[name] for name in AIMS} == pytest.approx(AIMS, abs=1.0)
    assert seen["front"] == robot.observation_features["front"] == (2, 4, 3)


def test_an_arm_without_torque_that_was_moved_by_hand_is_seen_where_it_is(trial: ArmTrial, make: Any) -> None:
    trial.robot.arm.release()
    trial.robot.arm.read()
    for name, pulses in AT.items():
        trial.board.servo(RANGES[name][0], position=pulses)
    robot = make()
    robot.connect()
    seen = robot.get_observation()
    assert {name: seen[name] for name in AIMS} == pytest.approx(AIMS, abs=2.0)


def test_an_arm_without_torque_that_can_not_be_read_now_keeps_its_last_reading(trial: ArmTrial, make: Any) -> None:
    trial.robot.arm.release()
    seen = trial.robot.arm.read()
    trial.robot.estop("somebody is in the way")
    wait_for("the latch", lambda: trial.robot.state.cause)
    robot = make(after_stop="wait")
    robot.connect()
    assert set(AIMS) <= set(robot.get_observation())
    assert trial.robot.arm.state.joints["base"].angle_rad == pytest.approx(seen["base"], abs=0.02)


@pytest.mark.parametrize("joints", [JOINTS, {}])
def test_the_wheels_turn_as_lekiwi_s_numbers_say(trial: ArmTrial, make: Any, joints: dict[str, str]) -> None:
    robot = make(joints=joints)
    robot.connect()
    assert list(robot.action_features) == [*(f"arm_{name}.pos" for name in joints), "x.vel", "y.vel", "theta.vel"]
    trial.robot.enable()

    def turns() -> bool:
        robot.send_action({"theta.vel": 30.0})
        return robot.get_observation()["theta.vel"] == pytest.approx(30.0)

    until(turns)
    left, right = trial.board.wheels()[:2], trial.board.wheels()[2:]
    assert trial.robot.state.body_vel.wz_radps == pytest.approx(0.5236, abs=1e-3)
    assert all(left)
    assert all(right)
    robot.disconnect()
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    with pytest.raises(DeviceNotConnectedError):
        robot.send_action(STILL)


def test_an_action_past_the_settings_range_is_sent_within_it(make: Any) -> None:
    robot = make(use_degrees=True)
    robot.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()
    sent = robot.send_action({"arm_wrist_flex.pos": 170.0, "arm_gripper.pos": 30.0})
    assert sent == pytest.approx({"arm_wrist_flex.pos": 500 * 360 / 1499, "arm_gripper.pos": 30.0})


@pytest.mark.parametrize("also", [STILL, {}])
def test_a_latched_stop_ends_the_run_with_the_reason(trial: ArmTrial, make: Any, also: dict[str, float]) -> None:
    robot = make()
    robot.connect()
    trial.robot.estop("somebody is in the way")
    wait_for("the latch", lambda: trial.robot.state.cause)
    with pytest.raises(RobotStopped, match="somebody is in the way"):
        robot.send_action({**AIMS, **also})


def test_a_latched_stop_can_be_waited_for(trial: ArmTrial, make: Any, caplog: pytest.LogCaptureFixture) -> None:
    robot = make(after_stop="wait")
    robot.connect()
    trial.robot.estop("somebody is in the way")
    wait_for("the latch", lambda: trial.robot.state.cause)
    before = trial.board.joints()

    def refused() -> bool:
        robot.send_action({**AIMS, **STILL, "x.vel": 0.1})
        return bool((arm := trial.robot.state.arm) and arm.refused)

    with caplog.at_level(logging.WARNING):
        until(refused)
        robot.send_action({**AIMS, **STILL, "x.vel": 0.1})
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 1
    assert "somebody is in the way" in told[0]
    assert trial.board.joints() == before
    assert not trial.turning()


@pytest.mark.parametrize(("at_end", "limp"), [("hold", 0), ("release", 6), ("park", 6)])
def test_the_arm_at_the_end_of_a_run(trial: ArmTrial, make: Any, at_end: str, limp: int) -> None:
    robot = make(at_end=at_end)
    robot.connect()
    for servo, tuck in ((1, 500), (2, 963), (3, 46), (4, 131), (5, 498), (10, 629)):
        trial.board.servo(servo, position=tuck - 20)
    trial.robot.arm.read()
    action = {f"arm_{name}.pos": 20.0 for name in JOINTS}
    until(lambda: robot.send_action(action) and not trial.board.limp())
    robot.disconnect()
    wait_for("the torque", lambda: len(trial.board.limp()) == limp)
    if at_end == "park":
        assert near(trial, {"shoulder_lift": 963, "elbow_flex": 46})


def in_a_finally(robot: Failstop, error: BaseException) -> None:
    """As lerobot_teleoperate, lerobot_record and lekiwi_host end."""
    try:
        raise error
    finally:
        robot.disconnect()


def by_with(robot: Failstop, error: BaseException) -> None:
    robot.disconnect()
    with robot:
        # A program whose first command the gate has not taken yet is no driver.
        until(lambda: robot.send_action(STILL) and robot._connected().state.sources)
        raise error


@pytest.mark.parametrize("end", [in_a_finally, by_with])
@pytest.mark.parametrize(("error", "died"), [(RuntimeError, True), (KeyboardInterrupt, False), (SystemExit, True)])
def test_a_run_that_an_exception_ends_is_a_crash(
    trial: ArmTrial, make: Any, end: Any, error: type[BaseException], died: bool
) -> None:
    """Somebody else has enabled motion, and a program that is started again commands at once."""
    robot = make()
    robot.connect()
    robot.send_action(STILL)
    trial.robot.enable()
    with pytest.raises(error):
        end(robot, error("out of memory"))
    wait_for("the slot to be free", lambda: not [one for one in trial.robot.state.clients if one.name == "lerobot"])
    assert trial.robot.state.enabled is not died


@pytest.mark.parametrize(("error", "released"), [(RuntimeError, False), (KeyboardInterrupt, True)])
def test_the_arm_is_let_go_only_where_the_run_ends_normally(
    trial: ArmTrial, make: Any, error: type[BaseException], released: bool
) -> None:
    robot = make(at_end="release")
    robot.connect()
    action = {f"arm_{name}.pos": 20.0 for name in JOINTS}
    until(lambda: robot.send_action(action) and not trial.board.limp())
    with pytest.raises(error):
        in_a_finally(robot, error("out of memory"))
    trial.robot.arm.read()  # after whatever else the servos were told
    assert len(trial.board.limp()) == (6 if released else 0)


def test_a_robot_that_is_freed_while_connected_is_a_crash(trial: ArmTrial, tmp_path: Path) -> None:
    """As where the exception is caught outside of the function that has the robot."""
    robot = Failstop(FailstopConfig(calibration_dir=tmp_path, service=trial.name, joints=JOINTS))
    robot.connect()
    robot.send_action(STILL)
    trial.robot.enable()
    del robot
    wait_for("the slot to be free", lambda: not [one for one in trial.robot.state.clients if one.name == "lerobot"])
    assert not trial.robot.state.enabled


def test_the_wheels_do_not_wait_for_a_camera_that_blocks(trial: ArmTrial, make: Any) -> None:
    robot = make(cameras={"front": CameraConfig(fps=30, width=4, height=2)})
    robot.connect()
    robot.send_action(STILL)
    parted: list[bool] = []

    def blocks() -> None:
        wait_for("the goodbye", lambda: not [one for one in trial.robot.state.clients if one.name == "lerobot"])
        parted.append(True)

    robot.cameras["front"].disconnect = blocks
    robot.disconnect()
    assert parted


def test_what_a_person_should_type_names_the_service(
    trial: ArmTrial, make: Any, caplog: pytest.LogCaptureFixture
) -> None:
    robot = make()
    robot.connect()
    with caplog.at_level(logging.WARNING):
        until(lambda: robot.send_action({**STILL, "x.vel": 0.1}) and caplog.records)
    assert f"the wheels stand still: disabled (`failstop why --name {trial.name}`)" in caplog.text


@pytest.mark.parametrize(
    ("given", "action", "told"),
    [
        ({"service": "nobody"}, {}, "nobody"),
        ({"joints": {"gripper": "claw"}}, {}, "no joint 'claw' for arm_gripper: they name base"),
        ({"joints": {"gripper": "roll"}}, {}, "arm_gripper is servo 5 by failstop's settings.*says servo 10"),
        ({}, {"arm_gripper.pos": nan}, "arm_gripper.pos is nan: every value must be finite"),
        ({}, {"x.vel": nan}, "every value must be finite"),
        ({}, {"gripper.pos": 1.0}, "no action 'gripper.pos': there are arm_shoulder_pan.pos"),
        ({"at_end": "drop"}, {}, "at_end is 'drop': must be hold or park or release"),
        ({"joints": {"claw": "gripper"}}, {}, "no joint 'claw': LeKiwi has shoulder_pan"),
        ({"teleop_keys": {"hop": "h"}}, {}, "no act 'hop' for a key: there are forward"),
    ],
)
def test_bad_input_is_refused_by_its_name(make: Any, given: Any, action: dict[str, float], told: str) -> None:
    def act() -> None:
        robot = make(**given)
        robot.connect()
        robot.send_action(action)

    with pytest.raises((ValueError, ConnectionError), match=told):
        act()


@pytest.mark.parametrize("axis", ["x.vel", "y.vel", "theta.vel"])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_wheel_s_number_that_is_not_finite_moves_no_joint(
    axis: str, value: float, trial: ArmTrial, make: Any
) -> None:
    robot = make()
    robot.connect()
    with pytest.raises(ValueError, match=rf"{axis} is .*: every value must be finite"):
        robot.send_action({**{name: number + 20.0 for name, number in AIMS.items()}, **STILL, axis: value})
    assert trial.robot.assert_interlocks() is None  # the gate has read this program's slot since
    arm = trial.robot.state.arm
    assert arm
    assert (arm.mode, arm.by, arm.moving) == ("", "", False)


def test_a_calibration_is_made_by_lerobot_alone(make: Any) -> None:
    robot = make()
    assert robot.is_calibrated
    with pytest.raises(RuntimeError, match=r"lerobot-calibrate --robot\.type=lekiwi --robot\.id=kiwi"):
        robot.calibrate()
