"""Nodes of another user: Fast DDS's shared memory keeps them apart, UDP does not. On the real ROS alone."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from failstop_lab.trial import wait_for
from tests.ros2.scene import FORWARD, SCAN, SENSOR, TWIST, BridgeTrial, Node, Ros, lacks, new_name
from tests.support.commands import failstop

NOBODY = 65534
PYTHON = "/usr/bin/python3"
"""A Python that every user may run."""
MIDDLEWARE = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"
PROFILE = """\
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="own" is_default_profile="true">
    <rtps><useBuiltinTransports>true</useBuiltinTransports></rtps>
  </participant>
</profiles>
"""
"""One of the user's own, with shared memory."""


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    if os.geteuid():
        pytest.skip("only root can be two users")
    if not shutil.which("setpriv"):
        pytest.skip("not installed: setpriv")
    found = Ros("real", tmp_path_factory.mktemp("ros"))
    if found.run(PYTHON, "-c", "import rclpy").returncode:
        lacks(f"{PYTHON} is not that of this ROS")
    return found


@pytest.mark.parametrize(
    "localhost",
    [
        {"ROS_LOCALHOST_ONLY": "0"},
        {"ROS_LOCALHOST_ONLY": "1"},
        {"ROS_LOCALHOST_ONLY": "0", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    ],
    ids=["network", "localhost only", "localhost range"],
)
@pytest.mark.parametrize("own_profile", [False, True])
def test_a_node_of_another_user(ros: Ros, tmp_path: Path, own_profile: bool, localhost: dict[str, str]) -> None:
    if own_profile and "fastrtps" not in ros.run(PYTHON, "-c", MIDDLEWARE).stdout:
        pytest.skip("only Fast DDS has such a profile")
    others = {name: value for name, value in ros.environment.items() if "DISCOVERY" not in name}
    ros.environment = {**others, **localhost}
    (tmp_path / "own.xml").write_text(PROFILE)
    log = Path("/tmp") / f"{new_name()}-log"
    log.mkdir(mode=0o777)
    log.chmod(0o777)
    own = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(tmp_path / "own.xml")}
    drop = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", PYTHON)
    try:
        with BridgeTrial(ros, new_name(), environment=own if own_profile else None) as scene:
            lidar = scene.node("lidar")
            lidar.publish("scan", SCAN, {}, qos=SENSOR)
            scene.enable()
            stranger = Node(ros, "stranger", interpreter=drop, environment={"ROS_LOG_DIR": str(log), "HOME": "/"})
            scene.nodes.append(stranger)
            stranger.publish("cmd_vel", TWIST, FORWARD, match=False)
            if not own_profile:
                scene.state(lambda state: state["publishers"] == ["/stranger"])
                scene.moving()
            else:
                wait_for("several of its commands to be lost", lambda: _sent(stranger, 60), 40.0)
                assert scene.state()["blocked"] == "cmd timeout"
            doctor = failstop("doctor", "--quick", "--name", scene.trial.name, timeout=60.0).stdout
            assert ("nodes of two users exchange no data" in " ".join(doctor.split())) == own_profile
    finally:
        shutil.rmtree(log, ignore_errors=True)


def _sent(node: Node, count: int) -> bool:
    return bool(node.ask("sent", topic="cmd_vel")["count"] >= count)
