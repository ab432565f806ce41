"""Every case runs on the stand-in, and on the real ROS where there is one."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.ros2.scene import IMU_HZ, BridgeTrial, Ros, new_name


@pytest.fixture(scope="module", params=["stand-in", "real"])
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    return Ros(request.param, tmp_path_factory.mktemp("ros"))


@pytest.fixture
def name() -> str:
    return new_name()


@pytest.fixture(scope="module")
def stage(ros: Ros, request: pytest.FixtureRequest) -> Iterator[BridgeTrial]:
    """A service and a bridge for all cases of a module, which may name options of the one (BRIDGE), settings of the
    other (SETTINGS), and how often the IMU tells (IMU_HZ)."""
    words = getattr(request.module, "BRIDGE", ())
    settings, imu_hz = getattr(request.module, "SETTINGS", ""), getattr(request.module, "IMU_HZ", IMU_HZ)
    with BridgeTrial(ros, new_name(), *words, settings=settings, imu_hz=imu_hz) as made:
        yield made


@pytest.fixture
def scene(stage: BridgeTrial) -> BridgeTrial:
    stage.fresh()
    return stage


@pytest.fixture(scope="module")
def offers(ros: Ros) -> bool:
    """True where this ROS has the action; the stand-in has none."""
    done = ros.run(sys.executable, "-c", "import rclpy, control_msgs.action")
    return done.returncode == 0
