"""A service that ends and is started again, as the topics of the bridge show it, on a robot that needs no scan."""

from __future__ import annotations

import math
import shutil
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from failstop.api.errors import FailstopError, NoService
from failstop.ros2.report import without_state
from failstop_lab.trial import Service, wait_for
from tests.ros2.scene import BOOL, NODE, BridgeTrial
from tests.support.leases import LEASES, TIMEOUT_S

SETTINGS = 'scan.gate = "off"\n'
BRIDGE = ("--ros-args", "-p", "publish_tf:=true")


def test_a_robot_that_needs_no_scan_drives_without_one_and_nothing_is_wrong(scene: BridgeTrial) -> None:
    scene.enable()
    scene.drive()
    scene.moving()
    assert scene.state(lambda state: state["publishers"] == ["/nav"])["wrong"] is None
    scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    rows = scene.eyes.next("/diagnostics", lambda message: "/nav" in str(message))["status"]
    [row] = [row for row in rows if row["name"].endswith(": ROS")]
    assert (row["level"], row["message"]) == (0, "cmd_vel: /nav; nobody publishes scan")


def test_status_says_that_no_service_runs(scene: BridgeTrial) -> None:
    topic = f"{NODE}/status"
    if topic not in scene.eyes.ask("graph")["topics"]:
        pytest.skip("failstop_msgs is not built here")
    scene.enable()
    scene.eyes.hear(topic, "failstop_msgs/msg/Status")
    scene.eyes.next(topic, lambda message: message["enabled"] and not message["latched"])
    scene.trial.leave()
    scene.trial.service.kill()
    try:
        found = scene.eyes.next(topic, lambda message: scene.trial.name in message["blocked"])
        assert (found["enabled"], found["latched"], found["link"]) == (
            False,
            True,
            without_state(NoService(""))["link"],
        )
        assert math.isnan(found["state_age_s"])
    finally:
        scene.trial.service.start()
    scene.eyes.next(topic, lambda message: not message["latched"])


def test_an_estop_that_comes_while_no_service_runs_latches_the_next_one(scene: BridgeTrial) -> None:
    button = scene.node("button")
    button.publish("estop", BOOL, {"data": False}, hz=1.0)
    button.ask("rest", topic="estop")
    scene.trial.leave()
    scene.trial.service.kill()
    try:
        scene.state(lambda state: state["state_age_ms"] is None)
        button.ask("publish", topic="estop", fields={"data": True})
        wait_for("the line", lambda: "estop topic, and there is nothing to stop: " in scene.bridge.said())
    finally:
        scene.trial.service.start()
    scene.state(lambda state: state["estop"] == "estop topic")
    wait_for("a reset to be taken", scene.trial.reset)
    scene.state(lambda state: state["state_age_ms"] is not None and state["estop"] is None)


def test_the_pose_goes_on_where_it_was(scene: BridgeTrial) -> None:
    def x_m(message: dict[str, Any]) -> float:
        return float(message["pose"]["pose"]["position"]["x"])

    scene.eyes.hear("wheel/odom", "nav_msgs/msg/Odometry", depth=400)
    scene.eyes.hear("/tf", "tf2_msgs/msg/TFMessage", depth=400)
    begun_m = x_m(scene.eyes.next("wheel/odom"))
    scene.enable()
    driver = scene.drive()
    scene.eyes.next("wheel/odom", lambda message: x_m(message) > begun_m + 0.1)
    scene.leave(driver)
    scene.standing()
    scene.trial.leave()
    scene.trial.service.kill()
    scene.state(lambda state: state["state_age_ms"] is None)
    stood_m = x_m(scene.eyes.take("wheel/odom")[-1][2])
    scene.eyes.take("/tf")
    scene.trial.service.start()
    scene.enable()
    assert x_m(scene.eyes.next("wheel/odom")) == pytest.approx(stood_m)
    [transform] = scene.eyes.next("/tf")["transforms"]
    assert transform["transform"]["translation"]["x"] == pytest.approx(stood_m)
    scene.drive()
    scene.eyes.next("wheel/odom", lambda message: x_m(message) > stood_m + 0.1)


@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs unshare")
def test_a_service_that_was_restarted_in_a_container_is_another_run(scene: BridgeTrial, tmp_path: Path) -> None:
    """Its supervisor always has the same pid there."""
    container = ("unshare", "--pid", "--fork", "--kill-child", "--mount-proc")
    if subprocess.run((*container, "true"), capture_output=True, check=False).returncode:
        pytest.skip("this user may not make a pid namespace")
    trial, file = scene.trial, tmp_path / "settings.toml"

    def is_ready() -> bool:
        try:
            return trial.robot.state.waiting_for is None
        except FailstopError:
            return False

    def has_timeout(timeout_s: float) -> bool:
        [value] = scene.eyes.ask("get_parameters", node=NODE, names=["cmd_timeout"])["values"]
        return bool(value["double_value"] == timeout_s)

    trial.leave()
    trial.service.end()
    service = Service(trial.name, trial.link, trial.state, ("--config", str(file)))
    service.become(*container)
    try:
        for timeout_s, interlock in ((TIMEOUT_S, ""), (TIMEOUT_S + 0.25, "[interlocks.ros2]\ntimeout_s = 1.0\n")):
            leases = LEASES.replace(str(TIMEOUT_S), str(timeout_s))
            file.write_text(f"{leases}{SETTINGS}{interlock}")
            service.exec()
            wait_for("the service", is_ready)
            assert trial.robot.state.processes["supervisor"].pid == 1
            scene.enable()
            wait_for("the new settings", partial(has_timeout, timeout_s))
            trial.leave()
            service.kill()
            scene.state(lambda state: state["state_age_ms"] is None)
    finally:
        service.kill()
        service.close()
        trial.service.start()
