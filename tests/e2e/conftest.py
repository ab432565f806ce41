"""The running service on a simulated board: what every end-to-end test starts from."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.trial import Trial
from tests.support.shared_trial import IMU_HZ, Keeper, patient
from tests.support.simulated import Simulated

_numbers = itertools.count()


@pytest.fixture
def name() -> str:
    """An instance name that no other test uses."""
    return f"e2e-{os.getpid()}-{next(_numbers)}"


@pytest.fixture(scope="module")
def keeper() -> Iterator[Keeper]:
    """It has the service of all tests of a file that leave theirs as they found it: while others run, it would cost as
    much as a start every ten seconds."""
    made = Keeper("e2e-kept")
    yield made
    made.end()


@pytest.fixture
def trial(keeper: Keeper) -> Trial:
    """Board, service and client with the default settings, whole and at rest, though others may have used them."""
    return keeper.take()


@pytest.fixture
def fresh(name: str, tmp_path: Path) -> Iterator[Trial]:
    """A trial of the test's own, which may damage what no state shows; the service must end well."""
    with Trial(name, patient(tmp_path), imu_hz=IMU_HZ) as running:
        yield running


@pytest.fixture
def simulated(request: pytest.FixtureRequest) -> Iterator[Simulated]:
    """The service on a simulated machine, with the SETTINGS of the test's module and the board of every_board; no
    program there may fail."""
    kind = getattr(request, "param", BOARDS[0])
    made = Simulated(getattr(request.module, "SETTINGS", None), kind=kind)
    yield made
    assert made.failed == []
