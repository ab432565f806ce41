"""A `failstop run` that Ctrl-Z has suspended: the wheels stop, and what is told of it is what has happened."""

from __future__ import annotations

import os
import signal
import time

import pytest

from failstop.lab.trial import Trial, wait_for
from failstop.messages.layout import SUPERVISOR
from failstop.policy import causes
from tests.support.commands import failstop

DATED_S = 0.5
"""The lease is 60 ms; the rest is for a busy machine."""


def shown(trial: Trial) -> str:
    return trial.robot.state.processes[SUPERVISOR].state


@pytest.fixture
def suspended(trial: Trial) -> float:
    """Unix time of the signal that has suspended the service, which drove; longer ago than a stop is followed."""
    pid = trial.service.pids()[SUPERVISOR]
    wait_for("an answer", lambda: trial.robot.state.device.link == "alive")
    trial.enable()
    trial.drive(0.3)
    assert trial.moving()
    unix_s = time.time()
    os.kill(pid, signal.SIGSTOP)  # SIGTSTP is discarded in an orphaned process group, as in CI
    begun_s = time.monotonic()
    wait_for("the wheels to stand", lambda: not trial.moving())
    wait_for("it to be told", lambda: shown(trial) == "suspended" and time.monotonic() - begun_s > 2.0)
    return unix_s


def test_while_it_is_suspended_the_first_step_is_to_let_it_go_on(trial: Trial, suspended: float) -> None:
    pid = trial.service.pids()[SUPERVISOR]
    why = " ".join(failstop("why", "--name", trial.name).stdout.split())
    os.kill(pid, signal.SIGCONT)
    assert (
        f"do let the suspended service go on (`fg` in its terminal, or `kill -CONT {pid}`), then `failstop res" in why
    )
    assert "real-time rights" not in why


def test_the_stop_has_the_time_of_its_cause_and_is_no_news_of_the_load(trial: Trial, suspended: float) -> None:
    os.kill(trial.service.pids()[SUPERVISOR], signal.SIGCONT)
    wait_for("it to go on", lambda: shown(trial) == "running" and bool(trial.robot.state.last_stop))
    wait_for("an acknowledgement", lambda: trial.robot.state.last_stop.acknowledged_s is not None)  # type: ignore[union-attr]
    state = trial.robot.state
    assert state.last_stop is not None
    assert state.cause is not None
    assert state.cause.kind is causes.SUPERVISOR_SUSPENDED
    assert 0 <= state.last_stop.t - suspended < DATED_S
    assert state.starved is None
    wait_for("its outcome", lambda: "by a signal: acknowledged by the board after " in trial.service.said())
    assert "starve" not in trial.service.said()
    trial.enable()
    trial.drive(0.3)
    assert trial.moving()
