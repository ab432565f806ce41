"""Every case runs on the stand-in, and on the real ROS where there is one."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.ros2.scene import BridgeTrial, Ros, new_name


@pytest.fixture(scope="module", params=["stand-in", "real"])
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    return Ros(request.param, tmp_path_factory.mktemp("ros"))


@pytest.fixture
def name() -> str:
    return new_name()


@pytest.fixture(scope="module")
def stage(ros: Ros, request: pytest.FixtureRequest) -> Iterator[BridgeTrial]:
    """A service and a bridge for all cases of a module, which may name options of the one (BRIDGE) and settings of the
    other (SETTINGS)."""
    words = getattr(request.module, "BRIDGE", ())
    with BridgeTrial(ros, new_name(), *words, settings=getattr(request.module, "SETTINGS", "")) as made:
        yield made


@pytest.fixture
def scene(stage: BridgeTrial) -> BridgeTrial:
    """The module's, as at its start."""
    stage.fresh()
    return stage


@pytest.fixture
def offers(ros: Ros) -> bool:
    """True where this ROS has the action; the stand-in has none."""
    done = ros.run(sys.executable, "-c", "import rclpy, control_msgs.action")
    return done.returncode == 0
