"""The board comes back while a process is dead, hangs, or has no room for the port: the stop is written, and motion is
not ready before all three have the port."""

from __future__ import annotations

import os
import resource
import signal
import time
from pathlib import Path

import pytest

from failstop.lab.trial import Trial, wait_for
from failstop.shm import layout

from .returns import drives_only_when_enabled, lose_while_driving, restarted_late, stop_at_return

LATEST_S = 0.9
"""Generous; 5 ms are usual."""


def test_while_the_port_owner_waits_for_its_restart(name: str, tmp_path: Path) -> None:
    with restarted_late(name, tmp_path, "port_owner") as trial:
        lose_while_driving(trial)
        os.kill(trial.service.pids()["port_owner"], signal.SIGKILL)
        wait_for("its death", lambda: trial.robot.state.processes["port_owner"].state == "waiting")
        event, late_s = stop_at_return(trial)
        assert event.is_stop
        assert late_s < LATEST_S
        wait_for("the stop to be known", lambda: (stop := trial.robot.state.last_stop) and stop.written_s is not None)
        drives_only_when_enabled(trial)


def test_while_the_port_owner_hangs(trial: Trial) -> None:
    """It is not needed for the stop."""
    lose_while_driving(trial)
    pid = trial.service.pids()["port_owner"]
    os.kill(pid, signal.SIGSTOP)
    silent_s = time.monotonic()
    wait_for("a silence that began before the return", lambda: time.monotonic() - silent_s > 0.05)
    event, late_s = stop_at_return(trial)
    assert event.is_stop
    assert late_s < LATEST_S
    wait_for("a new port owner", lambda: trial.service.pids()["port_owner"] != pid)
    drives_only_when_enabled(trial)


class NoNumbers:
    """A process has no free descriptor number, for the length of a block."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        used = set(map(int, os.listdir(f"/proc/{pid}/fd")))
        self._lowest = next(number for number in range(len(used) + 1) if number not in used)
        self._before = resource.prlimit(pid, resource.RLIMIT_NOFILE)

    def __enter__(self) -> None:
        resource.prlimit(self._pid, resource.RLIMIT_NOFILE, (self._lowest, self._before[1]))

    def __exit__(self, *_: object) -> None:
        resource.prlimit(self._pid, resource.RLIMIT_NOFILE, self._before)


@pytest.mark.parametrize("process", [layout.STOPPER, layout.PORT_OWNER, layout.SUPERVISOR])
def test_while_there_is_no_room_for_the_port(trial: Trial, process: str) -> None:
    lose_while_driving(trial)
    pids = trial.service.pids()
    with NoNumbers(pids[process]):
        event, late_s = stop_at_return(trial)
        assert event.is_stop
        assert late_s < LATEST_S
        if process == layout.SUPERVISOR:
            wait_for(
                "a service that is whole: it has kept a number for it", lambda: trial.robot.state.waiting_for is None
            )
        else:
            since_s = time.monotonic()
            wait_for("some tries", lambda: time.monotonic() - since_s > 0.3)
            assert trial.robot.state.waiting_for == "the port", "no motion without the second channel"
    drives_only_when_enabled(trial)
    after = trial.service.pids()
    assert after == pids
    # The second channel: nobody else is left to stop.
    trial.board.events()
    for hung in (layout.SUPERVISOR, layout.PORT_OWNER):
        os.kill(after[hung], signal.SIGSTOP)
    hung_ns = time.monotonic_ns()
    trial.drive(0.6)
    assert any(e.is_stop and e.arrival_ns > hung_ns for e in trial.board.events())
    assert not trial.moving()
    os.kill(after[layout.SUPERVISOR], signal.SIGCONT)
