"""Acts that a failing process of the service must not manage: to loop at real-time priority, to dump its memory."""

from __future__ import annotations

import os
import signal
import time

import pytest

from failstop.lab.faults import ptrace
from failstop.lab.trial import Trial, wait_for
from failstop.messages.layout import PROCESS_NAMES, SUPERVISOR
from failstop.procs.rights import LOOP_US, SUPERVISOR_LOOP_US
from failstop.shm.futex import NO_DUMP

LATEST_MS = 1500.0
"""The bar of a stop for a process that loops on the only core: the kernel ends it after 0.1 s; without real-time rights
the deadlines are 0.5 s at most."""


def limits(pid: int) -> dict[str, str]:
    """The soft limits of a process, in the words of proc(5)."""
    with open(f"/proc/{pid}/limits", encoding="utf-8") as file:
        return {line[:25].strip(): line[25:].split()[0] for line in file}


def test_every_process_ends_without_a_dump_and_when_it_loops(trial: Trial) -> None:
    for name, pid in trial.service.pids().items():
        found = limits(pid)
        assert int(found["Max core file size"]) <= NO_DUMP, name
        assert int(found["Max realtime timeout"]) == (SUPERVISOR_LOOP_US if name == SUPERVISOR else LOOP_US), name


def test_what_is_started_again_may_take_longer_for_its_start(hardy_trial: Trial) -> None:
    """A limit that it inherits would end it, on a slow machine, before it has begun."""
    gate = hardy_trial.service.pids()["gate"]
    os.kill(gate, 9)
    wait_for("another gate", lambda: hardy_trial.service.pids()["gate"] not in (0, gate))
    wait_for("the service to be ready", hardy_trial.service.ready)
    assert int(limits(hardy_trial.service.pids()["gate"])["Max realtime timeout"]) == LOOP_US


@pytest.mark.parametrize("process", [name for name in PROCESS_NAMES if name != SUPERVISOR])
def test_an_interrupt_is_an_end_at_once(hardy_trial: Trial, process: str) -> None:
    """No exception, and no interpreter that is taken down."""
    trial = hardy_trial
    trial.enable()
    trial.drive(0.2)
    pid = trial.service.pids()[process]
    trial.board.events()
    begun_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGINT)
    stop = trial.board.wait_for(lambda event: event.is_stop and event.arrival_ns >= begun_ns, 5.0)
    assert (stop.arrival_ns - begun_ns) / 1e6 < LATEST_MS
    wait_for("its end", lambda: trial.robot.state.processes[process].last_exit == "killed by SIGINT")
    assert "Traceback" not in trial.service.said()


@pytest.mark.alone
@pytest.mark.skipif(bool(ptrace.unfit()), reason=ptrace.unfit())
@pytest.mark.parametrize("process", PROCESS_NAMES)
def test_who_loops_on_the_only_core_is_stopped_for(fresh: Trial, process: str) -> None:
    """Above everybody who is to stop for it, but for the kernel."""
    fresh.enable()
    pids = fresh.service.pids()
    core = max(os.sched_getaffinity(0))
    for pid in pids.values():
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setaffinity(int(thread), {core})
    fresh.drive(0.2)
    assert fresh.moving()
    fresh.board.events()
    begun_ns = time.monotonic_ns()
    ptrace.spin(pids[process])
    stop = fresh.board.wait_for(lambda event: event.is_stop and event.arrival_ns >= begun_ns, 10.0)
    assert (stop.arrival_ns - begun_ns) / 1e6 < LATEST_MS
    if process == SUPERVISOR:
        fresh.leave()
        fresh.service.kill()
        return
    wait_for("another one", lambda: fresh.service.pids()[process] not in (0, pids[process]))
    assert fresh.robot.state.estop
