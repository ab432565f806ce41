"""Whatever ends or stops a controller manager while it drives, the board executes a stop, and nothing moves again
before somebody enables motion."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from failstop_lab.controller_manager import HZ, Manager
from failstop_lab.trial import Trial
from tests.support.waiting import until

from .scene import RADPS, drive, managed, needs_compiler, stopped, turns, urdf

pytestmark = [needs_compiler(), pytest.mark.slow]
SILENT = "stopped sending commands while it drove"
"""The service says it of a driver whose command's timeout stopped the wheels."""
HUNG_NS = 3_000_000_000
"""Later than this no command's timeout stops the wheels."""


def comes_back(manager: Manager, trial: Trial) -> None:
    """The next controller manager commands as the last one did, and nothing moves before an enable."""
    text = urdf("diff", service=trial.name)
    with managed(manager.release, text, manager.folder / "again") as again:
        again.until("state active")
        again.claim()
        again.set({f"{name}/velocity": 3.0 for name in again.joints})
        again.turn(HZ)
        assert not trial.robot.state.enabled
        assert not trial.turning()
        assert not any(event.is_motion for event in trial.board.events())


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("fault", ["SIGKILL", "SIGSEGV", "SIGABRT", "segv", "abort", "exit"])
def test_a_controller_manager_that_dies_stops_the_wheels(manager: Manager, trial: Trial, fault: str) -> None:
    drive(manager, trial)
    trial.board.events()
    fault_ns = time.monotonic_ns()
    if fault.startswith("SIG"):
        manager.signal(signal.Signals[fault])
    else:
        manager.send(fault)
    seen = stopped(trial, fault_ns)
    assert seen.stop_ns is not None
    assert seen.motion_after == 0
    trial.robot.wait_for("disabled", 5.0)
    manager.process.wait(5)
    assert not [line for line in manager.said if line.startswith(("on_deactivate", "on_error"))]
    comes_back(manager, trial)


@pytest.mark.claim("CLIENT-1")
@pytest.mark.parametrize("fault", ["SIGSTOP", "spin"])
def test_one_that_hangs_stops_the_wheels(manager: Manager, trial: Trial, fault: str) -> None:
    drive(manager, trial)
    trial.board.events()
    fault_ns = time.monotonic_ns()
    if fault == "spin":
        manager.send(fault)
    else:
        manager.signal(signal.SIGSTOP)
    seen = stopped(trial, fault_ns)
    assert seen.still_ns is not None
    assert seen.still_ns < HUNG_NS
    assert seen.motion_after == 0


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_one_stops_the_wheels_and_disables(
    manager: Manager, trial: Trial, number: signal.Signals
) -> None:
    drive(manager, trial)
    trial.board.events()
    fault_ns = time.monotonic_ns()
    manager.signal(number)
    seen = stopped(trial, fault_ns)
    assert seen.still_ns is not None
    assert seen.motion_after == 0
    assert manager.process.wait(5) == 0
    assert "on_deactivate SUCCESS" in manager.said
    state = trial.robot.state
    assert (state.enabled, state.estop) == (False, None), "an end in order latches nothing"
    comes_back(manager, trial)


@pytest.mark.claim("CLIENT-1", "MOVE-2")
def test_an_old_one_that_calls_nothing_at_ctrl_c(trial: Trial, tmp_path: Path) -> None:
    with managed("humble", urdf("diff", service=trial.name), tmp_path, old=True) as manager:
        drive(manager, trial)
        trial.board.events()
        fault_ns = time.monotonic_ns()
        manager.signal(signal.SIGINT)
        seen = stopped(trial, fault_ns)
        assert seen.still_ns is not None
        assert seen.motion_after == 0
        manager.process.wait(5)
        assert "on_deactivate SUCCESS" not in manager.said
        trial.robot.wait_for("disabled", 5.0)
        assert trial.robot.state.estop is None
        comes_back(manager, trial)


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("words", ["fail", "to deactivate"])
def test_an_error_or_a_deactivation_stops_the_wheels_and_disables(manager: Manager, trial: Trial, words: str) -> None:
    drive(manager, trial)
    trial.board.events()
    fault_ns = time.monotonic_ns()
    manager.send(words)
    seen = stopped(trial, fault_ns)
    assert seen.still_ns is not None
    assert seen.motion_after == 0
    manager.until("on_error SUCCESS" if words == "fail" else "on_deactivate SUCCESS")
    trial.robot.wait_for("disabled", 5.0)
    assert manager.process.poll() is None, "the manager lives on"
    # The controller goes on commanding, as it may. The hardware is activated again, and still moves nothing.
    if words == "fail":
        manager.send("to configure")
    manager.send("to activate")
    manager.until("state active", 2)
    trial.board.events()
    manager.turn(HZ)
    assert not any(event.is_motion for event in trial.board.events())
    drive(manager, trial)


def test_an_inactive_hardware_drives_nothing_though_humble_writes_to_it(trial: Trial, tmp_path: Path) -> None:
    with managed("humble", urdf("diff", service=trial.name), tmp_path) as manager:
        drive(manager, trial)
        manager.send("to deactivate")
        manager.until("state inactive", 2)
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        manager.set({f"{name}/velocity": 0.0 for name in manager.joints})
        manager.turn(2)
        trial.enable()
        trial.board.events()
        manager.set({f"{name}/velocity": 3.0 for name in manager.joints})
        manager.turn(HZ)
        assert not any(event.is_motion for event in trial.board.events())


def test_a_controller_that_leaves_stops_the_wheels_and_frees_the_source(manager: Manager, trial: Trial) -> None:
    drive(manager, trial)
    mark = trial.service.written()
    manager.send("unclaim")
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert SILENT not in trial.service.said(mark), "it commanded zero, and did not leave it to the timeout"
    until(lambda: not any(client.driving for client in trial.robot.state.clients), "the source to be free")
    assert trial.robot.state.enabled
    manager.send("claim")
    manager.set({f"{name}/velocity": 3.0 for name in manager.joints})
    turns(manager, trial)


def test_a_controller_that_comes_back_moves_nothing_before_it_writes(manager: Manager, trial: Trial) -> None:
    """The one that left has not set its interfaces to zero, so they still have the last speed."""
    drive(manager, trial)
    manager.send("abandon")
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    trial.board.events()
    manager.claim()
    manager.turn(HZ)
    assert trial.robot.state.enabled
    assert not any(event.is_motion for event in trial.board.events())
    manager.set({f"{name}/velocity": RADPS for name in manager.joints})
    turns(manager, trial)


def test_a_latched_stop_is_held_until_reset_and_enable(manager: Manager, trial: Trial) -> None:
    drive(manager, trial)
    trial.robot.estop("a test")
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    until(lambda: manager.values()["failstop/latched"] == 1.0, "the latch in a state interface")
    assert manager.values()["failstop/enabled"] == 0.0
    assert manager.said[-1] != "state unconfigured"
    assert "on_error SUCCESS" not in manager.said
    drive(manager, trial)
    until(lambda: manager.values()["failstop/latched"] == 0.0, "the reset in a state interface")


def test_a_latched_stop_is_an_error_where_the_urdf_says_so(trial: Trial, tmp_path: Path) -> None:
    text = urdf("diff", service=trial.name, more={"on_latched": "error"})
    with managed("lyrical", text, tmp_path) as manager:
        drive(manager, trial)
        trial.robot.estop("a test")
        manager.until("on_error SUCCESS")
        trial.board.wait_wheels(turning=False, timeout_s=5.0)


def test_a_controller_whose_topic_fell_silent_stops_the_wheels_and_drives_on(manager: Manager, trial: Trial) -> None:
    """It commands zero after its own timeout, and the next speed when the topic is back."""
    drive(manager, trial)
    mark = trial.service.written()
    manager.set({f"{name}/velocity": 0.0 for name in manager.joints})
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert SILENT not in trial.service.said(mark)
    assert trial.robot.state.enabled
    manager.set({f"{name}/velocity": 3.0 for name in manager.joints})
    turns(manager, trial)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_a_command_that_is_no_number_stops_the_wheels_and_latches_nothing(
    manager: Manager, trial: Trial, value: str
) -> None:
    drive(manager, trial)
    mark = trial.service.written()
    manager.set({f"{manager.joints[0]}/velocity": float(value)})
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert SILENT not in trial.service.said(mark), "it commanded zero, and did not leave it to the timeout"
    assert trial.robot.state.estop is None
    manager.set({f"{manager.joints[0]}/velocity": 3.0})
    turns(manager, trial)
