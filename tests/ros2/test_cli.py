"""The `ros2` command as a person types it, against the running bridge: the real ROS alone has one."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from failstop_lab.trial import wait_for
from tests.ros2.scene import FORWARD, NODE, TWIST, BridgeTrial, Ros, lacks


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    found = Ros("real", tmp_path_factory.mktemp("ros"))
    # Its daemon would outlive the tests; without it each call looks for itself.
    if found.run("ros2", "topic", "list", "--no-daemon").returncode:
        lacks("there is no working ros2 command")
    return found


def said(scene: BridgeTrial, *words: str) -> str:
    done = scene.ros.run(*words)
    assert done.returncode == 0, done.stdout + done.stderr
    return " ".join(done.stdout.split())


def test_topic_info(scene: BridgeTrial) -> None:
    scene.drive()
    text = said(scene, "ros2", "topic", "info", "-v", "--no-daemon", "--spin-time", "3", "/cmd_vel")
    assert "Type: geometry_msgs/msg/Twist Publisher count: 1 Node name: nav" in text
    assert "Subscription count: 1 Node name: rosorin_board_driver Node namespace: /" in text
    assert "Reliability: RELIABLE" in text


def test_topic_pub_and_echo(scene: BridgeTrial) -> None:
    scene.scan()
    scene.enable()
    done = scene.ros.run("ros2", "topic", "pub", "-t", "40", "-r", "20", "/cmd_vel", TWIST, str(FORWARD))
    assert done.returncode == 0, done.stderr
    what = ("--field", "linear_acceleration.z", "/imu/data_raw", "sensor_msgs/msg/Imu")
    text = said(scene, "ros2", "topic", "echo", "--once", *what)
    assert 9 < float(re.findall(r"[\d.]+", text)[0]) < 11
    assert any(event.is_motion for event in scene.trial.board.events())


def bridges(scene: BridgeTrial) -> set[int]:
    return {client.pid for client in scene.trial.robot.state.clients if client.name == "ros2"}


def test_launch_with_an_exit_handler(scene: BridgeTrial, tmp_path: Path) -> None:
    """The launch file of the driver before, with this bridge in its place: the handler still runs when it dies."""
    name = scene.trial.name
    launch = tmp_path / "old.launch.py"
    launch.write_text(
        f"""
from launch import LaunchDescription
from launch.actions import ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessExit


def generate_launch_description():
    bridge = ExecuteProcess(
        cmd=[{scene.bridge._command[0]!r}, "-m", "failstop", "ros2", "--name", {name!r},
             "--ros-args", "-r", "__ns:=/launched", "-r", "cmd_vel:=/launched/cmd_vel"],
        output="screen",
    )
    stop = ExecuteProcess(cmd=["sh", "-c", "touch {tmp_path / "stopped"}; sleep 1"])
    return LaunchDescription([bridge, RegisterEventHandler(OnProcessExit(target_action=bridge, on_exit=[stop]))])
"""
    )
    with open(tmp_path / "log", "w") as log:
        process = subprocess.Popen(
            ["ros2", "launch", str(launch)], env=scene.ros.environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )
    try:
        wait_for("its node", lambda: f"/launched{NODE}/enable" in scene.eyes.ask("graph")["services"], 20.0)
        wait_for("it to connect", lambda: len(bridges(scene)) == 2)
        launched = (bridges(scene) - {scene.bridge.process.pid}).pop()
        os.kill(launched, signal.SIGKILL)
        wait_for("the exit handler", (tmp_path / "stopped").exists, 20.0)
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
