"""Drivers of others, compiled once, and a service with a guard."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.guard.scene import HERE, GuardScene


@pytest.fixture(scope="session")
def diffdrive(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The program that makes diffdrive_arduino's calls."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        pytest.skip("needs a C compiler")
    made = tmp_path_factory.mktemp("drivers") / "diffdrive"
    subprocess.run([compiler, "-O1", "-Wall", "-o", str(made), str(HERE / "diffdrive.c")], check=True)
    return str(made)


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


@pytest.fixture
def own_scene(tmp_path: Path) -> Iterator[list[GuardScene]]:
    """Scenes that a test makes for itself, which end with it."""
    made: list[GuardScene] = []
    yield made
    for scene in made:
        scene.__exit__(None, None, None)
