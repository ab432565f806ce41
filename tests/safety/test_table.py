"""Powers of another local user, and their limits: each row of the page, tried as each of the four."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.safety import page
from tests.safety.attempts import ATTEMPTS, Attempt
from tests.safety.table import TABLE, USERS, Row
from tests.support.children import needs_root, reachable
from tests.support.shared_trial import IMU_HZ, patient, unheard

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    """One service for all."""
    with Trial(f"safety-{os.getpid()}", patient(tmp_path_factory.mktemp("safety")), imu_hz=IMU_HZ) as trial:
        yield trial


@pytest.fixture
def trial(running: Trial) -> Trial:
    """Stopped by nobody, driven by nobody, and whole."""
    running.leave()
    wait_for("the service to be whole", running.service.ready)
    wait_for("the last stop request to be heard", lambda: not unheard(running.name))
    if running.robot.state.estop:
        wait_for("a reset to be taken", running.reset)
    return running


@pytest.mark.claim("ACCESS-1", "ASK-1")
@needs_root
@pytest.mark.parametrize("user", USERS)
@pytest.mark.parametrize("row", [row for row in TABLE if row.attempt in ATTEMPTS], ids=lambda row: row.attempt)
def test_row(trial: Trial, tmp_path: Path, row: Row, user: str) -> None:
    reachable(tmp_path)
    assert ATTEMPTS[row.attempt](Attempt(trial, user, tmp_path)) is (user in row.can)


def test_every_row_has_an_attempt_or_a_test_and_every_attempt_a_row() -> None:
    elsewhere = [row.attempt for row in TABLE if row.attempt not in ATTEMPTS]
    for named in elsewhere:
        file, _, function = named.partition("::")
        assert f"def {function}(" in (ROOT / file).read_text(), named
    assert set(ATTEMPTS) == {row.attempt for row in TABLE} - set(elsewhere)
    assert len({row.what for row in TABLE}) == len(TABLE)


def test_the_page_has_the_table() -> None:
    assert page.PAGE.read_text() == page.renewed(), "python -m tests.safety"
