"""The arm by ROS: goals, poses, hold, and its keys of the state."""

from __future__ import annotations

import json

import pytest

from tests.ros2.scene import NODE, Scene
from tests.support.arm_settings import ARM, DRIVE, SERVOS

SETTINGS = "".join(f"{key} = {json.dumps(value)}\n" for key, value in ARM.items())
GOAL = "trajectory_msgs/msg/JointTrajectory"


def point(seconds: int, *positions: float) -> dict[str, object]:
    return {"positions": list(positions), "time_from_start": {"sec": seconds}}


def test_drive_pose_hold_and_state(scene: Scene) -> None:
    assert scene.eyes.call("arm/drive") == (True, "arm is there")
    state = scene.state(lambda state: not state["arm_moving"])
    assert state["arm_enabled"]
    assert state["arm_holding"]
    assert state["arm_pose"]["2"] == pytest.approx(DRIVE[1], abs=4)
    assert scene.eyes.call("arm/hold") == (True, "arm held")
    done, text = scene.eyes.call("arm/read_state")
    assert done
    assert set(json.loads(text)) == {"base", "shoulder", "elbow", "wrist", "roll", "gripper"}


def test_enable_goes_to_the_drive_pose_and_the_arm_is_refused_then(scene: Scene) -> None:
    assert scene.eyes.call("enable", data=True) == (True, "enabled")
    joints = scene.trial.board.joints()
    assert [joints[servo] for servo in SERVOS[1:5]] == pytest.approx(DRIVE[1:5], abs=2)
    assert scene.eyes.call("arm/release") == (False, "refused: wheels enabled")
    assert scene.eyes.call("enable", data=False) == (True, "disabled")


def test_a_blocked_joint_refuses_in_the_words_of_the_driver_before(scene: Scene) -> None:
    scene.trial.board.servo(2, position=400, blocked=True)
    try:
        done, text = scene.eyes.call("enable", data=True)
    finally:
        scene.trial.board.servo(2, blocked=False)
    assert not done
    assert text.startswith("refused: arm is not in the drive pose")


def test_the_arm_s_joints_are_joint_states(scene: Scene) -> None:
    scene.eyes.hear("joint_states", "sensor_msgs/msg/JointState")
    found = scene.eyes.next("joint_states", lambda message: "base" in message["name"])
    assert len(found["name"]) == len(found["position"]) == len(found["velocity"])
    scene.eyes.hear(f"{NODE}/arm_busy", "std_msgs/msg/Bool")
    scene.eyes.next(f"{NODE}/arm_busy", lambda message: message["data"] is False)
