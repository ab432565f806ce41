"""A service on a simulated board, and its page; a module's SETTINGS are those of both."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.trial import Trial
from tests.support.leases import LEASES
from tests.support.shared_trial import IMU_HZ
from tests.web.browser import Browser
from tests.web.parts import Web

_numbers = itertools.count()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as running:
        yield running


@pytest.fixture(scope="module")
def settings(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The settings' file."""
    path = tmp_path_factory.mktemp("settings") / "failstop.toml"
    text = getattr(request.module, "SETTINGS", "")
    # Where the page drives, how long its commands count is what is tried.
    path.write_text(text if "[sources.page]" in text else LEASES + text)
    return str(path)


@pytest.fixture(scope="module")
def trial(settings: str, request: pytest.FixtureRequest) -> Iterator[Trial]:
    """Board, service and client. A module may say how often the IMU tells (IMU_HZ)."""
    imu_hz = getattr(request.module, "IMU_HZ", IMU_HZ)
    with Trial(f"web-{os.getpid()}-{next(_numbers)}", ("--config", settings), imu_hz) as running:
        yield running


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of what the page says, besides its address."""
    return tmp_path_factory.mktemp("journal") / "web"


@pytest.fixture(scope="module")
def web(trial: Trial, settings: str, journal: Path) -> Iterator[Web]:
    """The page of it, which finds the trial's incidents, and is ended in order."""
    with journal.open("wb") as file, Web(trial.name, "--config", settings, state=trial.state, says=file) as running:
        yield running
        assert running.close() == 0
