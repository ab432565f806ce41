"""A `failstop run` that Ctrl-Z has suspended: the wheels stop, and what is told of it is what has happened."""

from __future__ import annotations

import os
import signal
import time

import pytest

from failstop import Refused
from failstop.messages.layout import SUPERVISOR
from failstop.policy import causes
from failstop_lab.trial import Trial, wait_for
from tests.support.commands import failstop
from tests.support.shared_trial import set_off


def shown(trial: Trial) -> str:
    return trial.robot.state.processes[SUPERVISOR].state


@pytest.mark.claim("TIME-1")
def test_a_suspended_service_stops_and_tells_what_has_happened(fresh: Trial) -> None:
    pid = fresh.service.pids()[SUPERVISOR]
    wait_for("an answer", lambda: fresh.robot.state.device.link == "alive")
    set_off(fresh)
    suspended_s = time.time()
    os.kill(pid, signal.SIGSTOP)  # SIGTSTP is discarded in an orphaned process group, as in CI
    begun_s = time.monotonic()
    wait_for("the wheels to stand", lambda: not fresh.turning())
    long = "it to be told, longer than a stop is followed"
    wait_for(long, lambda: shown(fresh) == "suspended" and time.monotonic() - begun_s > 2.0)
    why = " ".join(failstop("why", "--name", fresh.name).stdout.split())
    assert f"do resume the suspended service (`fg` in its terminal, or `kill -CONT {pid}`), then `failstop res" in why
    assert "real-time rights" not in why

    continued_s = time.time()
    os.kill(pid, signal.SIGCONT)
    wait_for("it to go on", lambda: shown(fresh) == "running" and bool(fresh.robot.state.last_stop))
    wait_for("an acknowledgement", lambda: fresh.robot.state.last_stop.acknowledged_s is not None)  # type: ignore[union-attr]
    state = fresh.robot.state
    assert state.last_stop is not None
    assert state.cause is not None
    assert state.cause.kind is causes.SUPERVISOR_SUSPENDED
    assert suspended_s <= state.last_stop.t < continued_s - 1.0, "the stop has the time of its cause"
    assert state.starved is None
    wait_for("its outcome", lambda: "by a signal: acknowledged by the board after " in fresh.service.said())
    assert "starve" not in fresh.service.said(), "it is no news of the load"
    set_off(fresh)


def test_motion_is_not_enabled_while_the_supervisor_is_suspended(fresh: Trial) -> None:
    """The gate would say that it is, and stop a tick later."""
    pid = fresh.service.pids()[SUPERVISOR]
    fresh.robot.wait_for("ready", 5.0)
    os.kill(pid, signal.SIGSTOP)
    wait_for("it to be told", lambda: shown(fresh) == "suspended")
    with pytest.raises(Refused, match=r"not ready: the supervisor has been silent for \d"):
        fresh.robot.enable()
    assert fresh.robot.state.cause is None
    os.kill(pid, signal.SIGCONT)
    wait_for("it to go on", lambda: shown(fresh) == "running")
    fresh.robot.wait_for("ready", 5.0)
    assert fresh.robot.enable()
