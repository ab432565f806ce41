"""A service on a simulated board, and its page; a module's SETTINGS are those of both."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from bench.web.parts import Web
from failstop.lab.trial import Trial

_numbers = itertools.count()


@pytest.fixture(scope="module")
def settings(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The settings' file."""
    path = tmp_path_factory.mktemp("settings") / "failstop.toml"
    path.write_text(getattr(request.module, "SETTINGS", ""))
    return str(path)


@pytest.fixture(scope="module")
def trial(settings: str) -> Iterator[Trial]:
    """Board, service and client."""
    with Trial(f"web-{os.getpid()}-{next(_numbers)}", ("--config", settings)) as running:
        yield running


@pytest.fixture(scope="module")
def web(trial: Trial, settings: str) -> Iterator[Web]:
    """The page of it, which finds the trial's incidents."""
    with Web(trial.name, "--config", settings, state=trial.state) as running:
        yield running
