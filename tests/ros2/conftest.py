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


@pytest.fixture
def name() -> str:
    return f"ros2-{os.getpid()}-{next(_numbers)}"


@pytest.fixture
def scene(ros: Ros, name: str) -> Iterator[Scene]:
    """A service and a bridge that nobody has done anything with."""
    with Scene(ros, name) as made:
        yield made
