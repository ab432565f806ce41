"""A simulator's time that nobody publishes."""

from __future__ import annotations

import time

from failstop.lab.trial import wait_for
from tests.ros2.scene import FORWARD, STAMPED, BridgeTrial, Ros, new_name


def test_with_a_simulator_s_time_that_nobody_publishes(ros: Ros) -> None:
    with BridgeTrial(ros, new_name(), "--ros-args", "-p", "use_sim_time:=true") as scene:
        scene.scan()
        driver = scene.node("nav")
        driver.publish("cmd_vel", STAMPED, {"twist": FORWARD}, stamp=True)
        scene.enable()
        told = "use_sim_time is true, and nobody publishes /clock"
        scene.state(lambda state: told in (state["wrong"] or ""))
        wait_for("the refusal", lambda: "cmd_vel is refused: how old its stamp is nobody knows" in scene.bridge.said())
        assert not scene.trial.moving(), "an age that nobody knows is no proof of youth"
        scene.eyes.hear("wheel/odom", "nav_msgs/msg/Odometry")
        stamp = scene.eyes.next("wheel/odom")["header"]["stamp"]
        assert abs(stamp["sec"] - time.time()) < 5
        driver.ask("repeat", topic="cmd_vel", fields={"twist": FORWARD}, hz=20.0)
        scene.moving()
