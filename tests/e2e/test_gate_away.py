"""What people are told while the gate is dead or hangs: what it published last says that the robot drives."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import instances
from failstop.api.errors import NoService
from failstop.api.state import StateReader
from failstop.lab.trial import Trial, wait_for
from failstop.shm import instance
from tests.support.commands import failstop

from .returns import restarted_late


@pytest.fixture
def late(name: str, tmp_path: Path) -> Iterator[Trial]:
    """A service that drives, and whose gate would be restarted after two seconds."""
    with restarted_late(name, tmp_path, "gate") as trial:
        trial.enable()
        trial.drive(0.2)
        assert trial.moving()
        assert trial.robot.state.body_vel[0] > 0
        yield trial


def test_a_dead_gate_drives_nothing(late: Trial) -> None:
    os.kill(late.service.pids()["gate"], signal.SIGKILL)
    wait_for("the stop to be told", lambda: late.robot.state.estop == "gate died")
    wait_for("its burial", lambda: late.robot.state.processes["gate"].state == "waiting")
    state = late.robot.state
    assert (state.enabled, state.blocked) == (False, "estop: gate died")
    assert not any((*state.body_vel, *state.wheels_radps))
    assert state.sources == ()
    assert [client.driving for client in state.clients] == [False]
    said = failstop("status", "--name", late.name).stdout
    assert "STOPPED" in said
    assert "DRIVING" not in said
    assert "a stop is latched" in " ".join(failstop("why", "--name", late.name).stdout.split())
    wait_for("its successor", lambda: late.robot.state.waiting_for is None)
    assert late.robot.state.estop == "gate died", "its successor says the same"


def test_a_gate_that_hangs_drives_nothing(late: Trial) -> None:
    gate = late.service.pids()["gate"]
    os.kill(gate, signal.SIGSTOP)
    wait_for("the stop to be told", lambda: (late.robot.state.estop or "").startswith("gate hangs"))
    state = late.robot.state
    row = state.processes["gate"]
    assert row.state != "running" or row.pid == gate, "nobody has taken over yet"
    assert not state.enabled
    assert not any(state.body_vel)
    late.recover("gate", gate)
    assert (late.robot.state.estop or "").startswith("gate hangs")


def test_a_reset_ends_the_story_of_the_supervisor(late: Trial) -> None:
    """The latch is not made up from a cause that was reset."""
    late.robot.estop("once")
    wait_for("the latch", lambda: late.robot.state.estop is not None)
    late.robot.reset()
    assert late.robot.state.estop is None
    assert late.robot.state.blocked == "disabled"


def test_a_service_without_its_supervisor_drives_nothing(trial: Trial) -> None:
    """What it said last is no longer so, and when nobody of it is left there is no state at all."""
    reader = StateReader(trial.name)
    trial.enable()
    trial.drive(0.2)
    assert trial.robot.state.enabled
    pid = trial.service.pids()["supervisor"]
    trial.kill("supervisor", 0.05)
    state = reader.read()
    assert (state.estop or "").startswith(("supervisor died", "supervisor hangs: "))
    assert (state.enabled, state.blocked) == (False, f"estop: {state.estop}")
    assert not any((*state.body_vel, *state.wheels_radps))
    paths = instance.places(trial.name)
    wait_for("the last process to end", lambda: not any(map(instances.running, paths)))
    with pytest.raises(NoService):
        _ = trial.robot.state
    trial.recover("supervisor", pid)
