"""A client of the arm's action that dies or hangs while the arm is on its way. Where the ROS has the action."""

from __future__ import annotations

import signal
import time

import pytest

from failstop.lab.trial import wait_for
from tests.ros2.arm_scene import ARM_SETTINGS, goal, point, send
from tests.ros2.scene import BridgeTrial, Ros, new_name


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_client_of_the_action_that_is_killed_or_stopped_holds_the_arm(ros: Ros, offers: bool, number: int) -> None:
    """DDS counts it for 20 s: what is missing at once is its acknowledgement of the feedback."""
    if not offers:
        pytest.skip("this ROS has no control_msgs")
    with BridgeTrial(ros, new_name(), settings=ARM_SETTINGS) as scene:
        planner = scene.node("planner")
        assert send(planner, goal(point(20, -0.5)))
        scene.state(lambda state: state["arm_moving"])
        time.sleep(1.5)  # longer than what is given to discovery, so that it can't be what holds the arm
        assert scene.state()["arm_moving"], "as long as it lives, it goes on"
        planner.process.send_signal(number)
        gone_s = time.monotonic()
        scene.state(lambda state: not state["arm_moving"])
        assert time.monotonic() - gone_s < 1.5
        assert "a node that hears of the goal has acknowledged nothing for 0.5 s: held" in scene.bridge.said()
        at = scene.trial.board.joints()[1]
        other = scene.node("other")
        assert not send(other, goal(point(1, 0.0))), "it can't be watched while the dead one counts"
        assert "DDS counts it for up to 20 s" in scene.bridge.said()
        assert scene.trial.board.joints()[1] == pytest.approx(at, abs=2)
        if number == signal.SIGSTOP:
            planner.process.send_signal(signal.SIGCONT)
            wait_for("the next goal to be taken", lambda: send(other, goal(point(1, 0.0))))


def test_without_control_msgs_the_log_and_the_diagnostics_say_so(ros: Ros) -> None:
    if ros.real:
        pytest.skip("the stand-in alone can be without")
    without = {"FAILSTOP_STANDIN_WITHOUT": "control_msgs"}
    with BridgeTrial(ros, new_name(), settings=ARM_SETTINGS, environment=without) as scene:
        said = "~/arm/follow_joint_trajectory is not offered: this ROS has no control_msgs/action/FollowJointTrajectory"
        wait_for("the line", lambda: scene.bridge.said().count(said) == 1)
        scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        rows = scene.eyes.next("/diagnostics", lambda message: said in str(message))["status"]
        assert [row["level"] for row in rows if said in row["message"]] == [0]
