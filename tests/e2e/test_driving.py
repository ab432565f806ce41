"""Driving: what the wheels do for what a client asks, seen by the board."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from failstop import Refused
from failstop.lab.trial import Trial, wait_for


def test_disabled_at_start(trial: Trial) -> None:
    trial.drive(0.1)
    assert not trial.moving()
    assert trial.robot.state.blocked == "disabled"


def test_forward_reaches_the_speeds_of_the_kinematics(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.6)
    assert trial.board.wheels() == pytest.approx((0.796, 0.796, -0.796, -0.796), abs=0.001)
    assert trial.robot.state.body_vel == pytest.approx((0.2, 0, 0))


def test_past_the_limit_is_clamped(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.7, (5.0, 0.0, 0.0))
    assert trial.board.wheels() == pytest.approx((0.796, 0.796, -0.796, -0.796), abs=0.001)


def test_ramp_on_the_wire(trial: Trial) -> None:
    trial.enable()
    trial.board.events()
    begun_ns = time.monotonic_ns()
    trial.drive(0.5)
    frames = [event for event in trial.board.events() if event.is_motion]
    rim_mps = 0.08 * 3.141592653589793
    speeds_mps = [event.speeds[0] * rim_mps for event in frames]
    assert speeds_mps == sorted(speeds_mps)
    assert len(set(speeds_mps)) > 5, "a ramp, not a step"
    for event, speed_mps in zip(frames, speeds_mps, strict=True):
        # Never ahead of the acceleration, but for the gate's first step of at most two periods. A port owner that was
        # held up writes the newest frame alone: between two frames the board may see any number of the gate's steps.
        assert speed_mps <= 0.5 * ((event.arrival_ns - begun_ns) / 1e9 + 0.040) + 1e-6


def test_command_timeout(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.3)
    last_ns = time.monotonic_ns()
    trial.robot.drive(0.2, 0.0, 0.0)
    event = trial.board.wait_for(lambda e: e.is_motor and not any(e.speeds) and e.arrival_ns > last_ns, 2.0)
    assert 0.3 <= (event.arrival_ns - last_ns) / 1e9 < 0.4
    wait_for("the block reason", lambda: trial.robot.state.blocked == "cmd timeout")
    assert trial.robot.state.enabled


def test_disable_stops_at_once(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.2)
    trial.board.events()
    trial.robot.disable()
    trial.drive(0.1)
    events = [event for event in trial.board.events() if event.is_motor]
    stop = next(i for i, event in enumerate(events) if event.is_stop)
    assert not any(event.is_motion for event in events[stop:])
    assert trial.robot.state.blocked == "disabled"
    assert trial.robot.state.estop is None


def test_not_finite_is_refused_by_the_client_and_moves_nothing(trial: Trial) -> None:
    trial.enable()
    with pytest.raises(ValueError, match="finite"):
        trial.robot.drive(float("nan"), 0.0, 0.0)


def test_not_finite_past_the_client_latches(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.1)
    trial.robot._client().command(float("nan"), 0.0, 0.0, manual=False, source="cmd_vel")
    wait_for("the latch", lambda: "not finite" in (trial.robot.state.estop or ""))
    trial.board.wait_wheels(moving=False, timeout_s=2.0)


def test_second_publisher_latches(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.1)
    code = (
        f"from failstop import Robot\nimport time\nwith Robot({trial.name!r}, client='rival') as r:\n"
        "    while True: r.drive(0.1, 0, 0); time.sleep(0.02)"
    )
    rival = subprocess.Popen([sys.executable, "-c", code])
    try:
        until = time.monotonic() + 10
        while not trial.robot.state.estop and time.monotonic() < until:
            trial.drive(0.05)
    finally:
        rival.kill()
        rival.wait()
    latch = trial.robot.state.estop or ""
    assert latch.startswith("multiple cmd_vel publishers: ")
    assert "trial (pid" in latch
    assert f"rival (pid {rival.pid})" in latch
    assert not trial.moving()


def test_death_of_the_driving_client(trial: Trial) -> None:
    trial.enable()
    code = (
        f"from failstop import Robot\nimport time\nwith Robot({trial.name!r}) as r:\n"
        "    while True: r.drive(0.2, 0, 0, manual=True); time.sleep(0.02)"
    )
    client = subprocess.Popen([sys.executable, "-c", code])
    trial.board.wait_for(lambda event: event.is_motion and event.speeds[0] > 0.3, 10.0)
    killed_ns = time.monotonic_ns()
    os.kill(client.pid, signal.SIGKILL)
    event = trial.board.wait_for(lambda e: e.is_motor and not any(e.speeds) and e.arrival_ns > killed_ns, 2.0)
    client.wait()
    # Well before the command timeout of 300 ms: its claim is gone.
    assert (event.arrival_ns - killed_ns) / 1e6 < 100
    assert not trial.robot.state.enabled
    assert trial.robot.state.estop is None


def test_enable_is_refused_while_latched_and_reset_does_not_enable(trial: Trial) -> None:
    trial.enable()
    trial.robot.estop("test")
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    with pytest.raises(Refused, match=r"a stop is latched \(stop request: test"):
        trial.robot.enable()
    assert "motion still disabled" in trial.robot.reset()
    assert not trial.robot.state.enabled
