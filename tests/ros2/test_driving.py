"""Driving by cmd_vel: what reaches the wheels, judged by the board."""

from __future__ import annotations

import math
import re
import time

import pytest

from failstop_lab.trial import wait_for
from tests.ros2.scene import BOOL, DEADLINE_S, FORWARD, NODE, SCAN, SENSOR, STAMPED, TWIST, BridgeTrial
from tests.support.commands import failstop
from tests.support.leases import TIMEOUT_S

NOT_FINITE = (
    *(("linear", "x", math.nan), ("linear", "y", math.inf), ("linear", "z", math.nan)),
    *(("angular", "x", -math.inf), ("angular", "y", math.nan), ("angular", "z", math.nan)),
)


def latched(scene: BridgeTrial) -> str:
    """The cause, once there is one."""
    estop: str = scene.state(lambda state: state["estop"])["estop"]
    return estop


@pytest.mark.parametrize(("kind", "stamp"), [(TWIST, False), (STAMPED, True), (STAMPED, False)])
def test_cmd_vel_drives(scene: BridgeTrial, kind: str, stamp: bool) -> None:
    """A stamp of zero counts as now."""
    scene.driving(kind=kind, stamp=stamp)
    state = scene.state(lambda state: state["body_vel"] == [0.2, 0.0, 0.0])
    assert state["publishers"] == ["/nav"]
    assert state["driver"].startswith("ros2 (pid ")
    wait_for("full speed", lambda: abs(scene.trial.board.wheels()[0] - 0.796) < 0.001)


def test_an_old_stamp_is_refused_and_whose_clock_disagrees_is_told_everywhere(scene: BridgeTrial) -> None:
    scene.scan()
    driver = scene.node("nav")
    stamp = {"sec": 1_600_000_000}
    driver.publish("cmd_vel", STAMPED, {"twist": FORWARD, "header": {"stamp": stamp}}, hz=20.0)
    scene.enable()
    wait_for("the line that says so", lambda: "cmd_vel is refused: its stamp is" in scene.bridge.said())
    # The next message of the state may be from before the enable.
    scene.state(lambda state: state["blocked"] == "cmd timeout")
    assert not scene.trial.turning()
    told = re.compile(
        "/nav publishes cmd_vel with stamps that are .* days old, and refused: is use_sim_time the same.*"
    )
    scene.state(lambda state: told.fullmatch(state["wrong"] or ""))
    scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    scene.eyes.next("/diagnostics", lambda message: "is use_sim_time the same" in str(message))

    def why() -> str:
        return " ".join(failstop("why", "--name", scene.trial.name).stdout.split())

    wait_for("`failstop why` to tell it", lambda: "ros2: /nav publishes cmd_vel with stamps" in why())
    assert "do fix what ros2 reports, then" in why()
    driver.ask("repeat", topic="cmd_vel", fields={"twist": FORWARD}, hz=20.0, stamp=True)
    scene.moving()
    scene.state(lambda state: state["wrong"] is None)


def test_what_is_not_finite_latches(scene: BridgeTrial) -> None:
    """A value that is not finite counts in the fields that a wheeled base has no use for, too: the sums went wrong."""
    driver = scene.driving()
    for part, axis, value in NOT_FINITE:
        driver.ask("publish", topic="cmd_vel", fields={part: {axis: value}})
        scene.state(lambda state: state["estop"] == "command from /nav is not finite")
        scene.standing()
        wait_for("a reset to be taken", scene.trial.reset)
        scene.state(lambda state: state["estop"] is None)


def test_estop_latches_and_false_does_nothing(scene: BridgeTrial) -> None:
    scene.eyes.hear(f"{NODE}/emergency_stop", BOOL)
    button = scene.node("button")
    button.publish("estop", BOOL, {"data": False})
    scene.driving()
    assert scene.eyes.next(f"{NODE}/emergency_stop")["data"] is False
    button.ask("rest", topic="estop")
    button.ask("publish", topic="estop", fields={"data": True})
    scene.standing()
    assert latched(scene) == "estop topic"
    scene.eyes.next(f"{NODE}/emergency_stop", lambda message: message["data"])
    assert scene.state()["blocked"] == "estop: estop topic"
    assert scene.eyes.call("enable", data=True) == (False, "refused: e-stop latched (estop topic)")


def test_every_publisher_of_estop_can_stop(scene: BridgeTrial) -> None:
    for qos in ({"reliable": False}, {"reliable": True}, {"lasting": True}):
        button = scene.node("button")
        button.publish("estop", BOOL, {"data": True}, hz=2.0, qos=qos)
        assert latched(scene) == "estop topic", qos
        scene.leave(button)
        wait_for("a reset to last", lambda: scene.trial.reset() and scene.state()["estop"] is None)
    nobody = "nobody publishes scan: start the lidar's node, or remap its topic"
    scene.state(lambda state: state["wrong"] == nobody)


def test_an_estop_from_before_the_bridge_latches_if_it_lasts(scene: BridgeTrial) -> None:
    button = scene.node("button")
    button.ask("advertise", topic="estop", type=BOOL, qos={"lasting": True, "depth": 1})
    for pressed in (True, False):
        scene.bridge.end()
        button.ask("publish", topic="estop", fields={"data": pressed})
        scene.bridge.start()
        scene.state(lambda state: state["state_age_ms"] is not None)
        if pressed:
            assert latched(scene) == "estop topic"
            wait_for("a reset to be taken", scene.trial.reset)
    assert scene.state()["estop"] is None, "the last one was false"


@pytest.mark.parametrize("lasting", [False, True])
def test_one_message_of_estop_is_one_stop(scene: BridgeTrial, lasting: bool) -> None:
    """A reliable publisher is heard by several subscriptions of the bridge."""
    button = scene.node("button")
    button.publish("estop", BOOL, {"data": False}, hz=1.0, qos={"lasting": lasting})
    before = scene.bridge.said().count("E-STOP: estop topic")
    button.ask("rest", topic="estop")
    button.ask("publish", topic="estop", fields={"data": True})
    latched(scene)
    button.ask("publish", topic="estop", fields={"data": True})
    wait_for("the second stop", lambda: scene.bridge.said().count("E-STOP: estop topic") >= before + 2)
    if scene.ros.real:  # the stand-in does not say when a message was sent
        assert scene.bridge.said().count("E-STOP: estop topic") == before + 2


def test_who_looks_late_sees_the_emergency_stop(scene: BridgeTrial) -> None:
    scene.trial.robot.estop("hand near wheel")
    latched(scene)
    scene.eyes.next(f"{NODE}/emergency_stop", lambda message: message["data"])
    dashboard = scene.node("dashboard")
    dashboard.hear("late", BOOL)
    dashboard.ask("hear", topic=f"{NODE}/emergency_stop", type=BOOL, qos={"lasting": True, "depth": 1})
    assert dashboard.next(f"{NODE}/emergency_stop")["data"] is True


def test_without_a_scan_nothing_moves_and_the_log_says_so(scene: BridgeTrial) -> None:
    scene.enable()
    scene.drive()
    state = scene.state(lambda state: state["blocked"] == "no scan")
    assert state["wrong"] == "nobody publishes scan: start the lidar's node, or remap its topic"
    wait_for("the line", lambda: "wheels held: no LiDAR scan for " in scene.bridge.said())
    lidar = scene.scan()
    scene.moving()
    wait_for("the other line", lambda: "LiDAR scan back: wheels released" in scene.bridge.said())
    assert scene.state(lambda state: state["wrong"] is None)["scan_age"] < 0.5
    lidar.ask("rest", topic="scan")
    scene.standing()
    state = scene.state(lambda state: state["blocked"] == "no scan")
    scene.state(lambda state: state["wrong"] == "/lidar publishes scan, but is silent")
    lidar.ask("repeat", topic="scan", fields={}, hz=20.0)
    scene.moving()


def test_a_silent_driver_stops_the_wheels(scene: BridgeTrial) -> None:
    driver = scene.driving()
    last_ns = driver.ask("rest", topic="cmd_vel")["t_ns"]
    stop = scene.trial.board.wait_for(lambda e: e.is_motor and not any(e.speeds) and e.arrival_ns > last_ns, DEADLINE_S)
    assert (stop.arrival_ns - last_ns) / 1e9 > 0.9 * TIMEOUT_S, "its last command counts for as long as is set"
    assert scene.state(lambda state: state["blocked"])["blocked"] == "cmd timeout"
    assert scene.state()["enabled"]


def test_scan_may_be_reliable_too(scene: BridgeTrial) -> None:
    lidar = scene.node("lidar")
    lidar.publish("scan", SCAN, {}, qos={"reliable": True})
    scene.state(lambda state: state["scan_age"] is not None and state["scan_age"] < 0.2 and state["wrong"] is None)
    assert SENSOR == {"reliable": False, "depth": 5}


def test_with_a_simulator_s_time_that_nobody_publishes(scene: BridgeTrial) -> None:
    with scene.another("--ros-args", "-p", "use_sim_time:=true") as bridge:
        scene.scan()
        driver = scene.node("nav")
        driver.publish("cmd_vel", STAMPED, {"twist": FORWARD}, stamp=True)
        scene.enable()
        told = "use_sim_time is true, and nobody publishes /clock"
        scene.state(lambda state: told in (state["wrong"] or ""))
        wait_for("the refusal", lambda: "cmd_vel is refused: nobody knows how old its stamp is" in bridge.said())
        assert not scene.trial.turning(), "an age that nobody knows is no proof of youth"
        driver.hear("wheel/odom", "nav_msgs/msg/Odometry")
        stamp = driver.next("wheel/odom")["header"]["stamp"]
        assert abs(stamp["sec"] - time.time()) < 5
        driver.ask("repeat", topic="cmd_vel", fields={"twist": FORWARD}, hz=20.0)
        scene.moving()
