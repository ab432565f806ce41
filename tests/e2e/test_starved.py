"""A machine that does not run the service: nothing is killed for it while motion is disabled, and a stop is a stop."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.lab.faults.starve import SHARP, Starved
from failstop.lab.trial import Trial, wait_for, write_settings
from failstop.policy.processes import BY_NAME
from failstop.shm.layout import GATE, PORT_OWNER, STOPPER, TELEMETRY
from failstop.supervisor import grant
from tests.support.commands import failstop

pytestmark = pytest.mark.alone

ORDINARY = """
import ctypes, os, resource, sys
CAP_IPC_LOCK, CAP_SYS_NICE, PR_CAPBSET_DROP = 14, 23, 24
for capability in (CAP_IPC_LOCK, CAP_SYS_NICE):
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability)
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
os.execv(sys.argv[1], sys.argv[1:])
"""
"""Run by root, this takes away what an ordinary user does not have."""


MORE_MS = 100.0
"""Beyond the deadline; far less than anybody's patience."""


def long_ms(process: str) -> float:
    return BY_NAME[process].deadline_ns / 1e6 + MORE_MS


def silent_ms(trial: Trial, process: str, pid: int) -> float:
    """How long it has been silent; without end when it was killed."""
    found = trial.robot.state.processes[process]
    return found.age_s * 1e3 if found.pid == pid else float("inf")


def longest_ms(trial: Trial) -> float:
    """The longest silence that was told of."""
    found = trial.robot.state.starved
    return found.longest_s * 1e3 if found else 0.0


def starve(trial: Trial, process: str, nice: int = SHARP) -> None:
    """Until it has been silent for long, or is another one; then it may run again."""
    pid = trial.service.pids()[process]
    with Starved(pid, nice):
        wait_for(f"{process} to be silent", lambda: silent_ms(trial, process, pid) >= long_ms(process))
    wait_for("the service to be ready", trial.service.ready)


@pytest.mark.parametrize("process", list(BY_NAME))
def test_while_idle_it_is_left_alone_and_that_is_told(trial: Trial, process: str) -> None:
    before = trial.service.pids()
    starve(trial, process)
    # Who was starved for less on the way to it was told of before.
    wait_for("the silence to be told of", lambda: longest_ms(trial) >= long_ms(process))
    state = trial.robot.state
    assert trial.service.pids() == before, trial.service.said()
    assert (state.estop, state.epoch) == (None, 1), "nothing was stopped either"
    assert "the machine starves the service: " in trial.service.said()
    for command in ("status", "why", "doctor --quick"):
        shown = failstop(*command.split(), "--name", trial.name).stdout
        assert "the machine starved the service: " in " ".join(shown.lower().split()), command
    if all(found.realtime for found in state.processes.values()):  # else others may have been starved for longer
        assert state.starved is not None
        assert state.starved.process == process


@pytest.mark.parametrize("process", [GATE, TELEMETRY, STOPPER])
def test_while_driving_the_wheels_are_stopped_and_nobody_is_killed(trial: Trial, process: str) -> None:
    trial.enable()
    trial.drive(0.3)
    assert trial.moving()
    before = trial.service.pids()
    with Starved(before[process], SHARP):
        # Not only standing wheels: a machine that keeps the driver waiting too ends a command by its timeout, and the
        # next one may move them.
        wait_for("a latched stop", lambda: trial.drive(0.02) or trial.robot.state.estop is not None)
        wait_for("the wheels to stand", lambda: not trial.moving())
        trial.board.events()
        wait_for(
            f"{process}'s deadline",
            lambda: trial.drive(0.02) or silent_ms(trial, process, before[process]) > long_ms(process),
        )
    wait_for("the service to be ready", trial.service.ready)
    assert not [event for event in trial.board.events() if event.is_motion], trial.service.said()
    assert trial.service.pids() == before, trial.service.said()
    latched = trial.robot.state.estop or ""
    if all(found.realtime for found in trial.robot.state.processes.values()):
        # For the gate the port owner has stopped, by its lease.
        words = "\\d+ ms silent" + ("" if process == GATE else " \\(the machine is starved\\)")
        assert re.fullmatch(f"{process} hangs: {words}", latched)
    trial.enable()


def test_while_driving_a_starved_port_owner_is_fenced_as_ever(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.3)
    pid = trial.service.pids()[PORT_OWNER]
    with Starved(pid, SHARP):
        wait_for("a latched stop", lambda: trial.drive(0.02) or trial.robot.state.estop is not None)
    wait_for("another port owner", lambda: trial.service.ready() and trial.service.pids()[PORT_OWNER] != pid)
    assert not trial.moving()
    assert "STOP latched: port_owner hangs: " in trial.service.said()
    assert "port_owner was fenced" in trial.service.said()


@pytest.fixture
def ordinary(name: str) -> Iterator[Trial]:
    """A service without rights."""
    trial = Trial(name)
    trial.service._command = [sys.executable, "-c", ORDINARY, *trial.service._command]
    with trial as running:
        assert not any(process.realtime for process in running.robot.state.processes.values())
        yield running


def test_without_rights_a_hang_is_stopped_for_when_a_busy_machine_could_not_be_the_reason(ordinary: Trial) -> None:
    assert ordinary.robot.state.lease_s == grant.LEASE_WITHOUT_S
    price = "200 ms instead of 60 to 100"
    wait_for("the lease to be told", lambda: price in ordinary.service.said())
    assert price in " ".join(failstop("status", "--name", ordinary.name).stdout.split())
    ordinary.enable()
    ordinary.drive(0.3)
    pid = ordinary.service.pids()[GATE]
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_for("a latched stop", lambda: ordinary.drive(0.02) or ordinary.robot.state.estop is not None)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    cause = ordinary.robot.state.cause
    assert cause is not None
    assert cause.arguments[0] == GATE
    assert float(cause.arguments[1]) >= 1e3 * grant.LEASE_WITHOUT_S
    wait_for("the wheels to stand", lambda: not ordinary.moving())


def test_a_service_without_rights_has_the_lease_that_its_settings_give(ordinary: Trial, tmp_path: Path) -> None:
    config = tmp_path / "short.toml"
    write_settings(str(config), {grant.LEASE: grant.LEASE_S})
    ordinary.leave()
    ordinary.service.end()
    ordinary.service._command += ["--config", str(config)]
    ordinary.service.start()
    assert ordinary.robot.state.lease_s == grant.LEASE_S
    wait_for("the price to be told", lambda: "some have no cause" in ordinary.service.said())


def test_a_service_without_rights_says_how_to_get_them_and_outlives_its_starving(ordinary: Trial) -> None:
    # It is written in the same turn in which the service is ready, a moment later.
    line = r"no real-time rights .*; give it real-time rights: .*rtprio=40"
    wait_for("the advice", lambda: re.search(line, ordinary.service.said()) is not None)
    before = ordinary.service.pids()
    for process in (PORT_OWNER, TELEMETRY):
        starve(ordinary, process, 0)  # gently: nobody else of it has rights either
    assert ordinary.service.pids() == before, ordinary.service.said()
    assert ordinary.robot.state.estop is None
    starved = "the machine starves the service"
    wait_for("it again", lambda: "give it real-time rights" in ordinary.service.said().partition(starved)[2])


def test_one_that_is_stopped_by_a_signal_is_not_starved(trial: Trial) -> None:
    pid = trial.service.pids()[TELEMETRY]
    os.kill(pid, signal.SIGSTOP)
    wait_for("another telemetry", lambda: trial.service.ready() and trial.service.pids()[TELEMETRY] != pid)
    assert "telemetry was fenced" in trial.service.said()
    assert trial.robot.state.starved is None
