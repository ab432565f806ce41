"""A robot with two wheels on an Arduino, whose board reports its encoders, kept for the tests of a file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.controller_manager import Manager
from failstop_lab.trial import Trial

from .scene import managed, trials, urdf


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    yield from trials("ros2-control", tmp_path_factory.mktemp("service"), "arduino")


@pytest.fixture
def trial(service: Trial) -> Trial:
    """Disabled, nothing latched, wheels at rest."""
    if service.robot.state.estop:
        service.robot.reset()
    service.robot.disable()
    service.board.wait_wheels(turning=False, timeout_s=5.0)
    service.board.events()
    return service


@pytest.fixture(params=["humble", "lyrical"])
def manager(request: pytest.FixtureRequest, trial: Trial, tmp_path: Path) -> Iterator[Manager]:
    """The oldest and the newest release, with a differential base."""
    with managed(request.param, urdf("diff", service=trial.name), tmp_path) as manager:
        yield manager
