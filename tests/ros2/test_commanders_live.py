"""Commanders: a second publisher, a stranger, a wrong type, and what people are told of them."""

from __future__ import annotations

import pytest

from failstop.policy import causes
from tests.ros2.scene import BOOL, FORWARD, NODE, STAMPED, TWIST, BridgeTrial
from tests.support.commands import failstop
from tests.support.leases import TIMEOUT_S
from tests.support.waiting import until

BACKWARD = {"linear": {"x": -0.2}}


def told(scene: BridgeTrial, text: str, *words: str) -> None:
    """Wait until a command tells it: the bridge's own topics do so first."""
    command = (*words, "--name", scene.trial.name)
    until(lambda: text in " ".join(failstop(*command).stdout.split()), f"`failstop {' '.join(words)}` to tell: {text}")


@pytest.mark.parametrize(("kind", "reliable"), [(TWIST, True), (STAMPED, False)])
def test_a_second_publisher_latches_and_moves_nothing(scene: BridgeTrial, kind: str, reliable: bool) -> None:
    scene.driving()
    second = scene.node("joystick")
    fields = {"twist": BACKWARD} if kind == STAMPED else BACKWARD
    second.publish("cmd_vel", kind, fields, hz=100.0, match=False, qos={"reliable": reliable})
    estop = scene.state(lambda state: "/joystick" in (state["estop"] or ""))["estop"]
    assert estop.startswith("multiple cmd_vel publishers: ")
    assert "/nav" in estop
    scene.standing()
    assert not [event for event in scene.trial.board.events() if event.is_motor and event.speeds[0] < 0]
    scene.state(lambda state: sorted(state["publishers"]) == ["/joystick", "/nav"])
    done, text = scene.eyes.call("reset_estop")
    assert not done
    assert text.startswith("refused: multiple cmd_vel publishers: ")
    assert "/joystick" in text
    assert "up to 20 s" in text
    scene.leave(second)
    scene.state(lambda state: state["publishers"] == ["/nav"])


@pytest.mark.parametrize(
    ("last", "other"),
    [("velocity_smoother", "behavior_server"), ("collision_monitor", "docking_server")],
    ids=["humble", "jazzy"],
)
def test_stock_nav2_is_told_what_to_remap_and_moves_when_it_is_done(scene: BridgeTrial, last: str, other: str) -> None:
    """Its navigation_launch.py lets one more node advertise cmd_vel, which is silent most of the time."""
    scene.driving(name=last)
    idle = scene.node(other)
    idle.ask("advertise", topic="cmd_vel", type=TWIST)
    scene.state(lambda state: f"/{other}" in (state["estop"] or "") and f"/{last}" in state["estop"])
    scene.standing()
    told(scene, f"do remap cmd_vel of /{other}: for a node of Nav2 to cmd_vel_nav, ", "why")
    scene.leave(idle)
    again = scene.node(other)
    again.ask("advertise", topic="cmd_vel_nav", type=TWIST)
    scene.state(lambda state: state["publishers"] == [f"/{last}"])
    scene.leave(next(node for node in scene.nodes if node.name == last))
    until(lambda: failstop("reset", "--name", scene.trial.name).returncode == 0, "the reset")
    scene.enable()
    scene.state(lambda state: state["blocked"] == "cmd timeout")
    scene.drive(last)
    scene.moving()


def test_a_behavior_server_that_starts_before_the_smoother_is_the_node_to_remap(scene: BridgeTrial) -> None:
    """Nav2 of Humble configures it first, and each of its behaviors has a publisher of its own."""
    server = scene.node("behavior_server")
    for _ in range(2):
        server.ask("advertise", topic="cmd_vel", type=TWIST)
    scene.state(lambda state: state["estop"] == "multiple cmd_vel publishers: /behavior_server (2 times)")
    told(scene, "do remap cmd_vel of /behavior_server: for a node of Nav2 to cmd_vel_nav, ", "why")


def test_the_second_publisher_is_named_everywhere(scene: BridgeTrial, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is silent, and the graph knows a new publisher before its name."""
    scene.drive()
    scene.node("joystick").ask("advertise", topic="cmd_vel", type=TWIST)
    scene.state(lambda state: "/joystick" in (state["estop"] or ""))
    names = ("multiple cmd_vel publishers: /nav, /joystick", "multiple cmd_vel publishers: /joystick, /nav")
    cause = scene.trial.robot.state.cause
    assert cause is not None
    assert causes.bare(cause) in names
    found = " ".join(failstop("why", "--name", scene.trial.name).stdout.split())
    assert any(name in found for name in names), found
    assert "written by the port owner after" in found, "the proofs of the first stop stay"
    if "not known yet" in scene.bridge.said():
        told(scene, "more is known about the latched cause: ", "events")
    monkeypatch.setenv("STATE_DIRECTORY", scene.trial.state)
    told(scene, "/joystick", "incident", "list")


def test_reset_is_refused_while_somebody_commands_motion(scene: BridgeTrial) -> None:
    driver = scene.drive()
    scene.trial.robot.estop("hand near wheel")
    scene.state(lambda state: state["estop"] and state["publishers"] == ["/nav"])
    done, text = scene.eyes.call("reset_estop")
    assert (done, text.partition(":")[0]) == (False, "refused")
    assert "/nav commands 0.2 m/s forward" in text
    assert text.endswith(f": let it send zero or nothing for {TIMEOUT_S:g} s, then reset again")
    driver.ask("repeat", topic="cmd_vel", fields={}, hz=20.0)
    found: tuple[object, str] = ("", "")
    while not str(found[1]).startswith("e-stop cleared"):
        found = scene.eyes.call("reset_estop")
    assert found[1].startswith("e-stop cleared (was: stop request: hand near wheel (")
    assert found[1].endswith("; motion still disabled")


def test_a_wrong_type_is_told_everywhere(scene: BridgeTrial) -> None:
    wrong = scene.node("confused")
    wrong.publish("cmd_vel", BOOL, {"data": True}, match=False)
    said = "/confused publishes Bool on cmd_vel, which is Twist or TwistStamped"
    state = scene.state(lambda state: said in (state["wrong"] or ""))
    assert state["estop"] is None, "one alone is no reason to stop"
    scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    row = next(
        row
        for row in scene.eyes.next("/diagnostics", lambda message: said in str(message))["status"]
        if row["name"] == f"{NODE[1:]}: ROS"
    )
    assert row["level"] == 1
    told(scene, said, "status")
    told(scene, f"ros2: {said}", "why")
    told(scene, f"ros2: {said}", "doctor", "--quick")
    told(scene, said, "events", "--kind", "said")


def test_a_wrong_scan_estop_and_quality_are_told(scene: BridgeTrial) -> None:
    shy = scene.node("shy")
    shy.publish("cmd_vel", TWIST, FORWARD, match=False, qos={"reliable": False})
    scene.state(lambda state: "/shy publishes cmd_vel as best effort" in (state["wrong"] or ""))
    node = scene.node("confused")
    node.publish("scan", "sensor_msgs/msg/PointCloud2", {}, match=False)
    node.publish("estop", "std_msgs/msg/String", {}, match=False)
    scene.state(lambda state: "/confused publishes PointCloud2 on scan, which is LaserScan" in (state["wrong"] or ""))
    scene.state(lambda state: "/confused publishes String on estop, which is Bool" in (state["wrong"] or ""))


def test_status_names_who_commands(scene: BridgeTrial) -> None:
    scene.scan()
    scene.drive()
    scene.state(lambda state: state["publishers"] == ["/nav"] and state["wrong"] is None)
    told(scene, "says ros2: cmd_vel: /nav; scan: /lidar", "status")
