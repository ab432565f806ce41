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

from failstop.messages.layout import GATE, PORT_OWNER
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.supervisor import status
from failstop_lab.faults.starve import Starved
from failstop_lab.trial import Trial, wait_for, write_settings
from tests.support.commands import failstop
from tests.support.shared_trial import IMU_HZ, goes_on
from tests.support.simulated import Simulated

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
MORE_S = 0.1
"""Beyond the deadline; far less than anybody's patience."""


def long_s(process: str) -> float:
    return PROCESS_BY_NAME[process].deadline_ns / 1e9 + MORE_S


@pytest.mark.parametrize("process", list(PROCESS_BY_NAME))
def test_while_idle_it_is_left_alone_and_that_is_told(simulated: Simulated, process: str) -> None:
    before = simulated.pids()
    simulated.hold(process, long_s(process), starved=True)
    simulated.wait(long_s(process) + 0.3)
    state = simulated.robot.state
    assert simulated.pids() == before
    assert (state.estop, state.epoch) == (None, 1), "nothing was stopped either"
    assert state.starved.process == process
    assert state.starved.longest_s == pytest.approx(long_s(process), abs=0.1)
    assert "the computer is too busy: " in simulated.said
    for command in ("status", "why"):
        assert "the computer is too busy: " in simulated.printed(command).lower(), command


# On the machine that there is, without rights.


def ordinary(trial: Trial) -> Trial:
    """A service without rights, to be entered."""
    trial.service.become(sys.executable, "-c", ORDINARY)
    return trial


@pytest.fixture(scope="module")
def running() -> Iterator[Trial]:
    with ordinary(Trial(f"e2e-starved-{os.getpid()}", imu_hz=IMU_HZ)) as made:
        assert not any(process.realtime for process in made.robot.state.processes.values())
        yield made


@pytest.mark.alone
def test_without_rights_a_hang_is_stopped_for_after_a_longer_lease(running: Trial) -> None:
    assert running.robot.state.lease_s == status.LEASE_WITHOUT_S
    price = "200 ms instead of 60 to 100"
    wait_for("the lease to be told", lambda: price in running.service.said())
    assert price in " ".join(failstop("status", "--name", running.name).stdout.split())
    running.enable()
    goes_on(running)
    pid = running.service.pids()[GATE]
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_for("a latched stop", lambda: running.drive(0.02) or running.robot.state.estop is not None)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    cause = running.robot.state.cause
    assert cause is not None
    assert cause.arguments[0] == GATE
    assert float(cause.arguments[1]) >= 1e3 * status.LEASE_WITHOUT_S
    wait_for("the wheels to stand", lambda: not running.turning())
    wait_for("the service to be ready", running.service.ready)
    wait_for("a reset to be taken", running.reset)


@pytest.mark.alone
def test_a_service_without_rights_has_the_lease_that_its_settings_give(name: str, tmp_path: Path) -> None:
    config = tmp_path / "short.toml"
    write_settings(str(config), {status.LEASE: status.LEASE_S})
    with ordinary(Trial(name, ("--config", str(config)), imu_hz=IMU_HZ)) as running:
        assert running.robot.state.lease_s == status.LEASE_S
        wait_for("the price to be told", lambda: "some stops will have no other reason" in running.service.said())


@pytest.mark.alone
def test_a_service_without_rights_says_how_to_get_them_and_outlives_its_starving(running: Trial) -> None:
    # It is written in the same turn in which the service is ready, a moment later.
    line = r"no real-time rights .*; give it real-time rights: .*rtprio=40"
    wait_for("the advice", lambda: re.search(line, running.service.said()) is not None)
    before = running.service.pids()
    with Starved(before[PORT_OWNER], 0):  # gently: nobody else of it has rights either
        wait_for("it to be silent", lambda: silent(running, PORT_OWNER, before[PORT_OWNER]))
    wait_for("the service to be ready", running.service.ready)
    assert running.service.pids() == before, running.service.said()
    assert running.robot.state.estop is None
    starved = "the computer is too busy"
    wait_for("it again", lambda: "give it real-time rights" in running.service.said().partition(starved)[2])


def silent(trial: Trial, process: str, pid: int) -> bool:
    """True where it has been silent for long, or is another one."""
    found = trial.robot.state.processes[process]
    return found.pid != pid or found.age_s >= long_s(process)
