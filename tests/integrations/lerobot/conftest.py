"""Every case of LeRobot's side runs on the stand-in, and on the real one where there is one. The tests themselves
import the plugin with the stand-in."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from failstop_lab.faults.arm import ArmTrial

from .scene import HERE, PLUGIN, VERSIONS, LeRobot, robot_with_an_arm

sys.path[:0] = [str(HERE / "standin"), str(PLUGIN)]


@pytest.fixture(scope="module", params=["stand-in", "real"])
def lerobot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> LeRobot:
    return LeRobot(request.param, tmp_path_factory.mktemp("lerobot"))


@pytest.fixture(scope="module", params=[*VERSIONS, "real"])
def every_lerobot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> LeRobot:
    """The stand-in in each version whose facts are recorded, and the real one."""
    folder = tmp_path_factory.mktemp("lerobot")
    return LeRobot("real", folder) if request.param == "real" else LeRobot("stand-in", folder, request.param)


@pytest.fixture(scope="module")
def running() -> Iterator[ArmTrial]:
    with robot_with_an_arm() as trial:
        yield trial


@pytest.fixture
def trial(running: ArmTrial) -> ArmTrial:
    """The robot with the arm in its drive pose and read, motion disabled, nothing latched."""
    running.settle()
    running.drive_pose()
    running.robot.arm.read()
    return running
