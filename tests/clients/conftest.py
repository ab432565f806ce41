"""The running service on a simulated board, and C clients of it."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.trial import Trial
from tests.support.c_client import Driver
from tests.support.comma import comma_locale
from tests.support.shared_trial import IMU_HZ, Keeper, patient

_numbers = itertools.count()


@pytest.fixture(scope="module")
def keeper() -> Iterator[Keeper]:
    """It has the service of all tests of a file that leave theirs as they found it."""
    made = Keeper("clients-kept")
    yield made
    made.end()


@pytest.fixture
def trial(keeper: Keeper) -> Trial:
    """Board, service and Python client with the default settings, whole and at rest."""
    return keeper.take()


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Trial]:
    """A trial of the test's own, which may damage what no state shows; the service must end well."""
    with Trial(f"clients-{os.getpid()}-{next(_numbers)}", patient(tmp_path), imu_hz=IMU_HZ) as running:
        yield running


@pytest.fixture
def comma(tmp_path: Path) -> dict[str, str]:
    """The environment of a program in whose locale a comma is the decimal point."""
    return comma_locale(tmp_path)


@pytest.fixture
def driver() -> Iterator[Driver]:
    """A C client that is not connected yet."""
    with Driver() as started:
        yield started


@pytest.fixture
def other() -> Iterator[Driver]:
    """Another C client that is not connected yet."""
    with Driver() as started:
        yield started
