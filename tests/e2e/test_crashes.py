"""Acts that a failing process of the service must not manage: to loop at real-time priority, to dump its memory."""

from __future__ import annotations

import os
import signal
import time

import pytest

from failstop.messages.layout import PROCESS_NAMES, SUPERVISOR
from failstop.procs.rights import LOOP_US, SUPERVISOR_LOOP_US
from failstop.shm.futex import NO_DUMP
from failstop_lab.faults import ptrace
from failstop_lab.trial import Trial, wait_for

OTHERS = tuple(name for name in PROCESS_NAMES if name != SUPERVISOR)
LATEST_MS = 1500.0
"""The bar of a stop for a process that loops on the only core: the kernel ends it after 0.1 s; without real-time rights
the deadlines are 0.5 s at most."""


def limits(pid: int) -> dict[str, str]:
    """The soft limits of a process, in the words of proc(5)."""
    with open(f"/proc/{pid}/limits", encoding="utf-8") as file:
        return {line[:25].strip(): line[25:].split()[0] for line in file}


def limited(trial: Trial) -> None:
    """Check that every process ends without a dump, and when it loops."""
    for name, pid in trial.service.pids().items():
        found = limits(pid)
        assert int(found["Max core file size"]) <= NO_DUMP, name
        assert int(found["Max realtime timeout"]) == (SUPERVISOR_LOOP_US if name == SUPERVISOR else LOOP_US), name


def test_every_process_is_limited_and_an_interrupt_is_an_end_at_once(fresh: Trial) -> None:
    """No exception, and no interpreter that is taken down. Who is started again may take longer for its start: a limit
    that it inherits would end it, on a slow machine, before it has begun."""
    limited(fresh)
    for process in OTHERS:
        fresh.enable()
        fresh.drive(0.1)
        pid = fresh.service.pids()[process]
        fresh.board.events()
        begun_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGINT)
        fresh.board.wait_for(lambda event, since=begun_ns: event.is_stop and event.arrival_ns >= since, 10.0)  # type: ignore[misc]
        wait_for("its end", lambda one=process: fresh.robot.state.processes[one].last_exit == "killed by SIGINT")  # type: ignore[misc]
        wait_for("a service that is whole", fresh.service.ready)
        assert "Traceback" not in fresh.service.said(), process
        assert fresh.service.pids()[process] != pid
    limited(fresh)


@pytest.mark.alone
@pytest.mark.skipif(bool(ptrace.unfit()), reason=ptrace.unfit())
def test_who_loops_on_the_only_core_is_stopped_for(fresh: Trial) -> None:
    """Above everybody who is to stop for it, but for the kernel. The supervisor, whose death ends all, is the last."""
    core = max(os.sched_getaffinity(0))
    for process in (*OTHERS, SUPERVISOR):
        fresh.enable()
        pids = fresh.service.pids()
        for pid in pids.values():
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.sched_setaffinity(int(thread), {core})
        fresh.drive(0.2)
        assert fresh.turning()
        fresh.board.events()
        begun_ns = time.monotonic_ns()
        ptrace.spin(pids[process])
        stop = fresh.board.wait_for(lambda event, since=begun_ns: event.is_stop and event.arrival_ns >= since, 10.0)  # type: ignore[misc]
        assert (stop.arrival_ns - begun_ns) / 1e6 < LATEST_MS, process
        if process == SUPERVISOR:
            continue
        wait_for("another one", lambda one=process, old=pids[process]: fresh.service.pids()[one] not in (0, old))  # type: ignore[misc]
        wait_for("a service that is whole", fresh.service.ready)
        assert fresh.robot.state.estop
    fresh.leave()
    fresh.service.kill()
