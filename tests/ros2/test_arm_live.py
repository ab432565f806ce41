"""The arm by ROS: goals, poses, hold, and its keys of the state."""

from __future__ import annotations

import json
import signal
import time
from math import isfinite

import pytest

from failstop.ros2.alive import DISCOVERY_NS
from failstop_lab.trial import wait_for
from tests.ros2.arm_scene import ARM_SETTINGS, GOAL, GOAL_TIMEOUT_S, goal, point, publish_once, send
from tests.ros2.scene import NODE, BridgeTrial, Node
from tests.support.arm_settings import DRIVE, SERVOS

SETTINGS = ARM_SETTINGS
UNHEARD = f"a node that receives the goal has acknowledged nothing for {GOAL_TIMEOUT_S:g} s, so the arm is held"


@pytest.fixture
def planner(scene: BridgeTrial, offers: bool) -> Node:
    if not offers:
        pytest.skip("this ROS has no control_msgs")
    return scene.node("planner")


def test_drive_pose_hold_and_state(scene: BridgeTrial) -> None:
    assert scene.eyes.call("arm/drive") == (True, "arm is there")
    state = scene.state(lambda state: not state["arm_moving"])
    assert state["arm_enabled"]
    assert state["arm_holding"]
    assert state["arm_pose"]["2"] == pytest.approx(DRIVE[1], abs=4)
    assert scene.eyes.call("arm/hold") == (True, "arm held")
    done, text = scene.eyes.call("arm/read_state")
    assert done
    assert set(json.loads(text)) == {"base", "shoulder", "elbow", "wrist", "roll", "gripper"}


def test_enable_goes_to_the_drive_pose_and_the_arm_is_refused_then(scene: BridgeTrial) -> None:
    assert scene.eyes.call("enable", data=True) == (True, "enabled")
    joints = scene.trial.board.joints()
    assert [joints[servo] for servo in SERVOS[1:5]] == pytest.approx(DRIVE[1:5], abs=2)
    assert scene.eyes.call("arm/release") == (False, "refused: wheels enabled")
    assert scene.eyes.call("enable", data=False) == (True, "disabled")


def test_goals_that_the_gate_refuses_are_rejected_in_its_words(scene: BridgeTrial, planner: Node) -> None:
    assert not send(planner, goal(point(1, 9.0)))
    assert not send(planner, goal(point(1, 0.0), joint="tail"))
    assert not send(planner, goal(point(1)))
    scene.enable()  # soon, as the arm is in the drive pose
    assert not send(planner, goal(point(1, 0.0)))
    said = scene.bridge.said()
    for words in ("joint base to 9 rad: allowed is", "no joint 'tail'", "a point without", "refused: wheels enabled"):
        assert words in said


def test_a_blocked_joint_refuses_in_the_words_of_the_driver_before(scene: BridgeTrial) -> None:
    scene.trial.board.servo(2, position=400, blocked=True)
    try:
        done, text = scene.eyes.call("enable", data=True)
    finally:
        scene.trial.board.servo(2, blocked=False)
    assert not done
    assert text.startswith("refused: arm is not in the drive pose")


def test_the_arm_s_joints_are_joint_states(scene: BridgeTrial) -> None:
    scene.eyes.hear("joint_states", "sensor_msgs/msg/JointState")
    found = scene.eyes.next("joint_states", lambda message: "base" in message["name"])
    assert len(found["name"]) == len(found["position"]) == len(found["velocity"])
    scene.eyes.hear(f"{NODE}/arm_busy", "std_msgs/msg/Bool")
    scene.eyes.next(f"{NODE}/arm_busy", lambda message: message["data"] is False)


def test_a_trajectory_by_the_action(scene: BridgeTrial, planner: Node) -> None:
    assert send(planner, goal(point(0, 0.0), point(1, 0.2), point(2, 0.1)))
    assert not send(planner, goal(point(1, 0.0))), "a second one while the first is under way"
    assert "cancel that first" in scene.bridge.said()
    found = planner.ask("outcome")
    assert (found["status"], found["error_code"]) == (4, 0), found
    assert scene.trial.board.joints()[1] == pytest.approx(500 + 0.1 / 0.0041888, abs=3)
    heard = planner.ask("fed_back")["feedback"]
    assert {tuple(row["joint_names"]) for row in heard} == {("base",)}
    desired = [row["desired"]["positions"][0] for row in heard]
    # Until the joint has been read, its commanded position is not known.
    assert max(filter(isfinite, desired)) == pytest.approx(0.2, abs=0.05), "it goes by the point in the middle"


def test_a_goal_that_is_cancelled_is_held(scene: BridgeTrial, planner: Node) -> None:
    assert send(planner, goal(point(20, 0.5)))
    wait_for("the arm to move", lambda: scene.state()["arm_moving"])
    other = scene.node("other")
    other.publish("arm/goal", GOAL, {"joint_names": ["base"], "points": [point(1, 0.0)]}, hz=5.0)
    wait_for("the topic's goal to be refused", lambda: "follow_joint_trajectory moves the arm" in scene.bridge.said())
    assert planner.ask("cancel")["cancelling"] == 1
    found = planner.ask("outcome")
    assert (found["status"], found["error_code"]) == (5, 0), found
    scene.state(lambda state: not state["arm_moving"])


def test_the_end_of_the_action_s_client_holds_the_arm(scene: BridgeTrial, planner: Node) -> None:
    assert send(planner, goal(point(20, -0.5)))
    wait_for("the arm to move", lambda: scene.state()["arm_moving"])
    scene.leave(planner)
    scene.state(lambda state: not state["arm_moving"])
    wait_for("the line", lambda: "nobody receives the goal any more, so the arm is held" in scene.bridge.said())


def test_a_listener_of_the_feedback_is_no_hindrance(scene: BridgeTrial, planner: Node) -> None:
    ear = scene.node("ear")
    assert not send(ear, goal(point(1, 0.0), joint="none")), "it hears the feedback from now on"
    assert send(planner, goal(point(0, 0.0), point(4, 0.1)))
    assert not send(ear, goal(point(1, 0.0)))
    assert planner.ask("outcome")["status"] == 4


def test_a_goal_of_the_topic_ends_with_its_publisher(scene: BridgeTrial) -> None:
    sender = scene.node("sender")
    start = scene.trial.board.joints()[1]
    wait_for("the arm to be seen", lambda: scene.state()["arm_enabled"])
    publish_once(sender, {"joint_names": ["base"], "points": [point(3, 0.9)]})
    scene.state(lambda state: state["arm_moving"])
    scene.leave(sender)
    wait_for("the line", lambda: "arm/goal: its publisher has gone, so the arm is held" in scene.bridge.said())
    scene.state(lambda state: not state["arm_moving"])
    assert abs(scene.trial.board.joints()[1] - start) < 180, "0.9 rad are 215 pulses"


def test_a_new_goal_of_the_same_publisher_takes_the_place_of_the_one_before(scene: BridgeTrial) -> None:
    sender = scene.node("sender")
    wait_for("the arm to be seen", lambda: scene.state()["arm_enabled"])
    publish_once(sender, {"joint_names": ["base"], "points": [point(3, 0.9)]})
    scene.state(lambda state: state["arm_moving"])
    sender.ask("publish", topic="arm/goal", fields={"joint_names": ["base"], "points": [point(1, -0.1)]})
    end = 500 - 0.1 / 0.0041888
    wait_for("the end of the second", lambda: abs(scene.trial.board.joints()[1] - end) < 3)
    scene.state(lambda state: not state["arm_moving"])
    assert scene.trial.board.joints()[1] == pytest.approx(end, abs=3)
    assert scene.state()["estop"] is None, "one publisher is no reason to stop"


def test_a_long_goal_of_the_topic_is_refused(scene: BridgeTrial) -> None:
    sender = scene.node("sender")
    publish_once(sender, {"joint_names": ["base"], "points": [point(1, 0.1), point(8, 0.2)]})
    said = "arm/goal: refused: it takes 8 s, and nobody can see whether its sender lives: 3 s at most (arm.unwatched_s)"
    wait_for("the refusal", lambda: said in scene.bridge.said())
    assert not scene.state()["arm_moving"]


def test_two_that_send_goals_latch_are_named_and_hold_the_reset(scene: BridgeTrial) -> None:
    first, second = scene.node("first"), scene.node("second")
    for node in (first, second):
        node.ask("advertise", topic="arm/goal", type=GOAL)
    scene.state(lambda state: (state["estop"] or "").startswith("multiple arm/goal publishers: /first, /second"))
    wait_for("the bridge to hear it", lambda: second.ask("matched", topic="arm/goal")["count"] > 0)
    second.ask("publish", topic="arm/goal", fields={"joint_names": ["base"], "points": [point(1, 0.1)]})
    wait_for("the refusal", lambda: "arm/goal: refused: multiple arm/goal publishers: " in scene.bridge.said())
    done, text = scene.eyes.call("reset_estop")
    assert not done
    assert text.startswith("refused: multiple arm/goal publishers: /first, /second")
    scene.leave(second)

    def reset() -> bool:
        return bool(scene.eyes.call("reset_estop")[0])

    wait_for("a reset", reset)


def test_a_goal_that_is_old_moves_nothing(scene: BridgeTrial) -> None:
    """A goal is old by its stamp, or since the bridge did not run while it lay there."""
    planner = scene.node("old_planner")
    late = {"joint_names": ["base"], "points": [point(1, 0.3)]}
    at = scene.state()["arm_pose"]["1"]
    planner.publish("arm/goal", GOAL, {"header": {"stamp": {"sec": 1}}, **late}, hz=5.0)
    wait_for("the refusal for its stamp", lambda: "arm/goal: refused: its stamp is" in scene.bridge.said())
    planner.ask("rest", topic="arm/goal")
    scene.bridge.send(signal.SIGSTOP)
    try:
        before = planner.ask("sent", topic="arm/goal")["count"]
        planner.ask("repeat", topic="arm/goal", fields=late, hz=5.0)
        wait_for("goals that are too old", lambda: planner.ask("sent", topic="arm/goal")["count"] > before + 6)
        planner.ask("rest", topic="arm/goal")
    finally:
        scene.bridge.send(signal.SIGCONT)
    wait_for("the refusal for its age", lambda: "arm/goal: refused: it waited" in scene.bridge.said())
    assert scene.state()["arm_pose"]["1"] == pytest.approx(at, abs=4)


def test_a_request_that_may_have_waited_moves_no_arm(scene: BridgeTrial) -> None:
    assert scene.eyes.call("arm/tuck")[0]
    at = scene.trial.board.joints()
    for service in ("arm/drive", "arm/tuck", "arm/release"):
        done, text = scene.call_asleep(service)
        assert not done
        assert text.startswith("refused: it may have waited for ")
    assert scene.trial.board.joints() == at
    assert scene.call_asleep("arm/hold") == (True, "arm held")
    assert scene.call_asleep("arm/read_state")[0]
    assert scene.eyes.call("arm/drive") == (True, "arm is there")


def test_without_control_msgs_the_log_and_the_diagnostics_say_so(scene: BridgeTrial) -> None:
    if scene.ros.real:
        pytest.skip("the stand-in alone can be without")
    with scene.another(environment={"FAILSTOP_STANDIN_WITHOUT": "control_msgs"}) as bridge:
        said = "~/arm/follow_joint_trajectory is not offered: this ROS has no control_msgs/action/FollowJointTrajectory"
        wait_for("the line", lambda: bridge.said().count(said) == 1)
        listener = scene.node("listener")
        listener.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        rows = listener.next("/diagnostics", lambda message: said in str(message))["status"]
        assert [row["level"] for row in rows if said in row["message"]] == [0]


def test_a_client_of_the_action_that_is_stopped_or_killed_holds_the_arm(scene: BridgeTrial, planner: Node) -> None:
    """DDS counts it for 20 s: what is missing at once is its acknowledgement of the feedback."""
    other = scene.node("other")
    for number in (signal.SIGSTOP, signal.SIGKILL):
        held = scene.bridge.said().count(UNHEARD)
        assert send(planner, goal(point(20, -0.5)))
        scene.state(lambda state: state["arm_moving"])
        time.sleep(DISCOVERY_NS / 1e9 + 0.5)  # so that it can't be what is given to discovery that holds the arm
        assert scene.state()["arm_moving"], "as long as it lives, it goes on"
        planner.process.send_signal(number)
        scene.state(lambda state: not state["arm_moving"])
        assert scene.bridge.said().count(UNHEARD) == held + 1
        at = scene.trial.board.joints()[1]
        assert not send(other, goal(point(1, 0.0))), "it can't be watched while the dead one counts"
        assert "DDS counts it for up to 20 s" in scene.bridge.said()
        assert scene.trial.board.joints()[1] == pytest.approx(at, abs=2)
        if number == signal.SIGSTOP:
            planner.process.send_signal(signal.SIGCONT)
            wait_for("the next goal to be taken", lambda: send(other, goal(point(1, 0.0))))
            assert other.ask("outcome")["status"] == 4
    planner.process.wait()
