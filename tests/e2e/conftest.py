"""The running service on a simulated board: what every end-to-end test starts from."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.lab.trial import Trial
from tests.support.simulated import Simulated

_numbers = itertools.count()

MANY_DEATHS = "[restart]\ndeaths = 100000\nbackoff_s = 0.001\n"


@pytest.fixture
def name() -> str:
    """An instance name that no other test uses."""
    return f"e2e-{os.getpid()}-{next(_numbers)}"


@pytest.fixture
def trial(name: str) -> Iterator[Trial]:
    """Board, service and client with the default settings; the service must end well."""
    with Trial(name) as running:
        yield running


@pytest.fixture
def simulated(request: pytest.FixtureRequest) -> Iterator[Simulated]:
    """The service on a simulated machine, with the SETTINGS of the test's module; no program there may fail."""
    made = Simulated(getattr(request.module, "SETTINGS", None))
    yield made
    assert made.failed == []


@pytest.fixture
def hardy_trial(name: str, tmp_path: Path) -> Iterator[Trial]:
    """A trial in which so many deaths are no crash loop."""
    config = tmp_path / "many-deaths.toml"
    config.write_text(MANY_DEATHS)
    with Trial(name, ("--config", str(config))) as running:
        yield running
