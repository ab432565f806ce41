"""Drivers of others, compiled once, and a service with a guard."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bench import guard_scene
from bench.guard_scene import GuardScene
from failstop_lab.trial import TrialError


@pytest.fixture(scope="session")
def diffdrive(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The program that makes diffdrive_arduino's calls."""
    try:
        return guard_scene.diffdrive(tmp_path_factory.mktemp("drivers"))
    except TrialError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def _arduino(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp("arduino"), "arduino") as scene:
        yield scene


@pytest.fixture
def arduino(_arduino: GuardScene) -> Iterator[GuardScene]:
    """A service for an Arduino with a guard, at rest and disabled, and nobody at its port."""
    _arduino.trial.robot.disable()
    _arduino.rest()
    _arduino.trial.board.events()
    yield _arduino
    _arduino.end_drivers()
