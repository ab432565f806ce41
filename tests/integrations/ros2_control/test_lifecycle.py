"""Every order of the hardware's transitions, begun while the wheels turn. While it is not active the wheels stand still
and motion is disabled; when it is active again, nothing moves before somebody enables motion. The controller commands
all the while."""

from __future__ import annotations

import itertools
import os
import signal
import time
from pathlib import Path

import pytest

from failstop.supervisor import status
from failstop_lab.controller_manager import HZ, Manager
from failstop_lab.trial import Trial
from tests.support.amounts import amount
from tests.support.waiting import until

from .scene import drive, managed, needs_compiler, settings, urdf

pytestmark = [needs_compiler(), pytest.mark.slow]
STEPS = {
    "to deactivate": {"active": "inactive"},
    "to cleanup": {"inactive": "unconfigured"},
    "to configure": {"unconfigured": "inactive"},
    "to activate": {"inactive": "active"},
    "to shutdown": dict.fromkeys(("unconfigured", "inactive", "active", "finalized"), "finalized"),
    "fail": dict.fromkeys(("inactive", "active"), "unconfigured"),
}
"""What each does, by state. `fail`: read() fails, which is called of a configured hardware alone."""
BACK = {"unconfigured": ("to configure", "to activate"), "inactive": ("to activate",)}
ORDERS = [order for length in range(1, amount(4, 6)) for order in itertools.product(STEPS, repeat=length)]


def after(state: str, step: str) -> str:
    return STEPS[step].get(state, state)


def walks(order: tuple[str, ...]) -> bool:
    """Whether each step of it does something, and the first ends the motion."""
    state = "active"
    for step in order:
        if state == "finalized" or state not in STEPS[step]:
            return False
        state = after(state, step)
    return True


def taken(manager: Manager, trial: Trial, order: tuple[str, ...]) -> str:
    """Take the steps, and judge after each; returns the state at the end."""
    state = "active"
    for step in order:
        state = after(state, step)
        before = manager.said.count(f"state {state}")
        manager.send(step)
        manager.until(f"state {state}", before + 1)
        trial.robot.wait_for("disabled", 5.0)
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        trial.board.events()
        if state == "active":
            manager.turn(5)
        assert not any(event.is_motion for event in trial.board.events()), order
    assert trial.robot.state.estop is None, order
    return state


@pytest.mark.parametrize("release", ["humble", "lyrical"])
def test_nothing_moves_in_any_order(release: str, trial: Trial, tmp_path: Path) -> None:
    manager: Manager | None = None
    number = 0
    try:
        for order in filter(walks, ORDERS):
            if manager is None:
                manager = managed(release, urdf("diff", service=trial.name), tmp_path / str(number := number + 1))
                manager.__enter__()
            drive(manager, trial)
            state = taken(manager, trial, order)
            if state == "finalized":
                manager.__exit__()
                manager = None
                continue
            again = manager.said.count("state active")
            manager.send(*BACK.get(state, ()))
            manager.until("state active", again + (state != "active"))
    finally:
        if manager is not None:
            manager.__exit__()
    assert number > 1, "some orders end a hardware for good"


def test_an_error_disables_though_the_hardware_is_closed_before_the_gate_has_heard_it(tmp_path: Path) -> None:
    """As on a busy machine, on which the gate runs late."""
    name = f"ros2-late-{os.getpid()}"
    late = settings(tmp_path, "arduino", **{status.LEASE: 1.0, "gate.command_timeout_s": 2.0})
    with Trial(name, late, imu_hz=20.0, kind="arduino") as trial:
        (tmp_path / "manager").mkdir()
        with managed("lyrical", urdf("diff", service=name), tmp_path / "manager") as manager:
            drive(manager, trial)
            gate = trial.service.pids()["gate"]
            os.kill(gate, signal.SIGSTOP)
            try:
                manager.send("fail")
                manager.until("on_error SUCCESS")
                manager.send("to shutdown")
                time.sleep(2 / HZ)  # long enough for a close that waits for nothing
            finally:
                os.kill(gate, signal.SIGCONT)
            manager.until("on_shutdown SUCCESS")
            until(lambda: not trial.robot.state.enabled, "motion to be disabled")
            assert trial.robot.state.estop is None, "the gate was not taken for hung"
