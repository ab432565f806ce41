"""The running service on a simulated board: what every end-to-end test starts from."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from failstop.lab.trial import Trial, wait_for
from tests.support.shared_trial import IMU_HZ, Keeper
from tests.support.simulated import Simulated

_numbers = itertools.count()

MANY_DEATHS = "[restart]\ndeaths = 100000\nbackoff_s = 0.001\n"


@pytest.fixture
def name() -> str:
    """An instance name that no other test uses."""
    return f"e2e-{os.getpid()}-{next(_numbers)}"


@pytest.fixture(scope="package")
def keeper() -> Iterator[Keeper]:
    """It has the service of all tests that leave theirs as they found it."""
    made = Keeper("e2e-kept")
    yield made
    made.end()


@pytest.fixture
def trial(keeper: Keeper) -> Trial:
    """Board, service and client with the default settings, whole and at rest, though others may have used them."""
    return keeper.take()


@pytest.fixture
def fresh(name: str) -> Iterator[Trial]:
    """A trial of the test's own, which may damage what no state shows; the service must end well."""
    with Trial(name, imu_hz=IMU_HZ) as running:
        yield running


@pytest.fixture
def simulated(request: pytest.FixtureRequest) -> Iterator[Simulated]:
    """The service on a simulated machine, with the SETTINGS of the test's module; no program there may fail."""
    made = Simulated(getattr(request.module, "SETTINGS", None))
    yield made
    assert made.failed == []


@pytest.fixture(scope="package")
def hardy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    """A trial in which many deaths are no crash loop."""
    config = tmp_path_factory.mktemp("hardy") / "many-deaths.toml"
    config.write_text(MANY_DEATHS)
    with Trial(f"e2e-hardy-{os.getpid()}", ("--config", str(config)), imu_hz=IMU_HZ) as running:
        yield running


@pytest.fixture
def hardy_trial(hardy: Trial) -> Iterator[Trial]:
    """A trial of many deaths, with every process alive: a test may kill them."""
    wait_for("a service that is whole", hardy.service.ready)
    yield hardy
    hardy.leave()
