"""still.command as docs/safety.md has it: it runs when wheels do not obey a stop, and only where the IMU says so."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.api.events import EventLog
from failstop.lab.trial import Trial, wait_for, write_settings

AFTER_S = 1.5


@pytest.fixture
def ran(tmp_path: Path) -> Path:
    """The file that the command makes, as a relay would open."""
    return tmp_path / "ran"


@pytest.fixture
def trial(name: str, ran: Path, tmp_path: Path) -> Iterator[Trial]:
    settings = tmp_path / "still.toml"
    write_settings(str(settings), {"still.command": f"touch {ran}"})
    with Trial(name, ("--config", str(settings))) as running:
        yield running


@pytest.mark.slow
def test_wheels_that_turn_on_have_it_run_once(trial: Trial, ran: Path) -> None:
    log = EventLog(trial.name)
    trial.enable()
    trial.drive(1.0)
    trial.board.refuse_stop(True)
    trial.robot.estop("the wheels turn on")
    stopped_s = time.monotonic()
    wait_for("the command", ran.exists)
    assert AFTER_S - 0.2 < time.monotonic() - stopped_s < AFTER_S + 1.0
    ran.unlink()
    time.sleep(2 * AFTER_S)
    assert trial.moving()
    assert not ran.exists(), "once for each such stop"
    told = [event.text for event in log.read() if event.kind == "command"]
    assert [text.partition(" (pid")[0] for text in told] == ["still.command runs", "still.command"]
    assert told[1].endswith("ended with code 0")
    trial.board.refuse_stop(False)


@pytest.mark.slow
def test_without_an_imu_nobody_knows(trial: Trial, ran: Path) -> None:
    trial.enable()
    trial.drive(1.0)
    trial.board.imu(False)
    trial.board.refuse_stop(True)
    trial.robot.estop("the wheels turn on")
    time.sleep(2 * AFTER_S)
    assert trial.moving()
    assert not ran.exists()
    trial.board.refuse_stop(False)


@pytest.mark.slow
def test_wheels_that_obey_do_not_have_it_run(trial: Trial, ran: Path) -> None:
    trial.enable()
    trial.drive(1.0)
    trial.robot.estop("stop")
    time.sleep(2 * AFTER_S)
    assert not ran.exists()
