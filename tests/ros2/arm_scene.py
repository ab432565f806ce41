"""Settings with an arm, goals and how they are sent, for the tests of the arm by ROS."""

from __future__ import annotations

import json

from failstop_lab.trial import wait_for
from tests.ros2.scene import NODE, Node
from tests.support.arm_settings import ARM

GOAL_TIMEOUT_S = 1.0
"""Renewed within this time by a busy machine, too."""
ARM_SETTINGS = "".join(
    f"{key} = {json.dumps(value)}\n" for key, value in {**ARM, "arm.goal_timeout_s": GOAL_TIMEOUT_S}.items()
)
GOAL = "trajectory_msgs/msg/JointTrajectory"
ACTION = f"{NODE}/arm/follow_joint_trajectory"
ACTION_TYPE = "control_msgs/action/FollowJointTrajectory"


def point(seconds: int, *positions: float) -> dict[str, object]:
    return {"positions": list(positions), "time_from_start": {"sec": seconds}}


def goal(*points: dict[str, object], joint: str = "base") -> dict[str, object]:
    return {"trajectory": {"joint_names": [joint], "points": list(points)}}


def send(planner: Node, fields: dict[str, object]) -> bool:
    found = planner.ask("send_goal", action=ACTION, type=ACTION_TYPE, fields=fields)
    assert "error" not in found, found
    return bool(found["accepted"])


def publish_once(node: Node, fields: dict[str, object]) -> None:
    node.ask("advertise", topic="arm/goal", type=GOAL)
    wait_for("the bridge to hear arm/goal", lambda: node.ask("matched", topic="arm/goal")["count"] > 0)
    node.ask("publish", topic="arm/goal", fields=fields)
