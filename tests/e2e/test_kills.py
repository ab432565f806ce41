"""Whichever process is killed, at whatever moment: it stops, in time, and nothing moves again without an enable."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import pytest

from failstop.api.errors import Refused
from failstop.lab.trial import Trial, wait_for
from failstop.shm import layout
from failstop.shm.layout import PORT_OWNER, STOPPER, TELEMETRY
from tests.support.commands import failstop

KILLS = 8
LATEST_MS = 100
"""A generous absolute limit for shared and busy machines; the bars are in the bench, beside their floor."""


@pytest.mark.parametrize("process", layout.PROCESSES)
def test_kill_while_driving(hardy_trial: Trial, process: str) -> None:
    trial = hardy_trial
    chance = random.Random(process)
    for _ in range(KILLS):
        trial.enable()
        pid = trial.service.pids()[process]
        stopped = trial.kill(process, chance.uniform(0.06, 0.14))
        assert stopped.was_moving
        assert stopped.stop_ns is not None, f"no stop after {process} was killed"
        assert stopped.stop_ns < LATEST_MS * 1e6
        assert stopped.still_ns is not None
        assert stopped.motion_after == 0
        trial.recover(process, pid)
        trial.drive(0.05)
        assert not trial.moving(), "a restarted process must not enable motion"


@pytest.mark.parametrize("process", [p for p in layout.PROCESSES if p != layout.SUPERVISOR])
def test_latched_with_who_died(trial: Trial, process: str) -> None:
    trial.enable()
    pid = trial.service.pids()[process]
    trial.kill(process)
    trial.recover(process, pid)
    state = trial.robot.state
    assert state.estop == f"{process} died"
    assert state.processes[process].last_exit == "killed by SIGKILL"
    assert state.blocked == f"estop: {state.estop}"
    assert not state.enabled
    assert state.last_stop is not None
    assert state.last_stop.reason == state.estop
    assert state.last_stop.written_s is not None
    with pytest.raises(Refused, match=r"a stop is latched \(.* died\)"):
        trial.robot.enable()
    trial.robot.reset()
    assert trial.robot.state.blocked == "disabled"
    trial.drive(0.1)
    assert not trial.moving(), "a reset must not enable motion"
    trial.robot.enable()
    trial.drive(0.1)
    assert trial.moving()


def test_first_cause_is_kept_over_a_gate_restart(trial: Trial) -> None:
    trial.enable()
    trial.board.events()
    trial.robot.estop("the first")
    trial.board.wait_for(lambda event: event.is_stop, 2.0)
    pid = trial.service.pids()["gate"]
    trial.kill("gate")
    trial.recover("gate", pid)
    assert (trial.robot.state.estop or "").startswith("stop request: the first")


def test_after_too_many_deaths_it_stays_down_and_stopped(trial: Trial) -> None:
    pids = []
    for _ in range(5):
        pid = trial.service.pids()["telemetry"]
        pids.append(pid)
        trial.kill("telemetry", 0.0)
        if len(pids) < 5:
            trial.recover("telemetry", pid)
    assert len(set(pids)) == 5
    state = trial.robot.state
    assert state.processes["telemetry"].state == "down"
    assert state.waiting_for == "telemetry"
    trial.robot.reset()
    with pytest.raises(Refused, match="not ready"):
        trial.robot.enable()
    assert "died too often" in trial.service.said()


@pytest.mark.parametrize("process", [TELEMETRY, STOPPER, PORT_OWNER])
def test_one_that_died_too_often_is_started_anew_by_a_reset(name: str, tmp_path: Path, process: str) -> None:
    config = tmp_path / "one-death.toml"
    config.write_text("[restart]\ndeaths = 1\n")
    with Trial(name, ("--config", str(config))) as trial:
        os.kill(trial.service.pids()[process], signal.SIGKILL)
        wait_for("the end of it", lambda: trial.robot.state.processes[process].state == "down")
        wait_for("the gate's latch", lambda: trial.robot.state.estop is not None)
        assert f"{process} died too often and is down" in trial.service.said()
        shown = failstop("status", "--name", name).stdout
        assert "next      `failstop reset" in shown
        assert f"{process} died too often and is down until a reset" in shown
        assert failstop("reset", "--name", name).returncode == 0
        wait_for("the service to be ready", trial.service.ready)
        trial.enable()
        trial.drive(0.3)
        assert trial.moving()
