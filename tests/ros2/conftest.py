"""Every case runs on the stand-in, and on the real ROS where there is one."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from tests.ros2.scene import Ros, Scene

_numbers = itertools.count()


@pytest.fixture(scope="module", params=["stand-in", "real"])
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    return Ros(request.param, tmp_path_factory.mktemp("ros"))


def _name() -> str:
    return f"ros2-{os.getpid()}-{next(_numbers)}"


@pytest.fixture
def name() -> str:
    return _name()


@pytest.fixture(scope="module")
def stage(ros: Ros, request: pytest.FixtureRequest) -> Iterator[Scene]:
    """A service and a bridge for all cases of a module, which may name options of the one (BRIDGE) and settings of the
    other (SETTINGS)."""
    words = getattr(request.module, "BRIDGE", ())
    with Scene(ros, _name(), *words, settings=getattr(request.module, "SETTINGS", "")) as made:
        yield made


@pytest.fixture
def scene(stage: Scene) -> Scene:
    """The module's, as at its start."""
    stage.fresh()
    return stage
