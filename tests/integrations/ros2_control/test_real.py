"""The plugin, and diffdrive_arduino at the guard port, in a real controller manager with diff_drive_controller:
`make ros2-control`, where ROS 2 is installed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import pytest

from failstop_lab.trial import wait_for

from .real import MPS, PLUGINS, ROS, STARTS_S, Real, Ros, struck
from .scene import stopped

pytestmark = [
    pytest.mark.skipif(not ROS, reason="no ROS 2 (make ros2-control)"),
    pytest.mark.slow,
    pytest.mark.timeout(900),
]
HUNG_NS = 3_000_000_000
"""Later than this no command's timeout stops the wheels."""
OBEYS_S = 1.0
"""A controller manager that is started again commands for so long, in vain."""
DEATHS = ["SIGKILL", "SIGSEGV", "SIGABRT", "segv", "abort", "exit"]
HANGS = ["SIGSTOP", "spin"]
OURS = "failstop_ros2_control"
FAILED = "Deactivating following hardware components"
WAITS = "waiting up to 10 s for the service"
ECHO = ("ros2", "topic", "echo", "--once", "--no-daemon")


@pytest.fixture(scope="module")
def ros() -> Ros:
    return Ros()


@pytest.fixture(scope="module", params=PLUGINS)
def launched(request: pytest.FixtureRequest, ros: Ros, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Real]:
    if lacking := ros.lacks(request.param):
        pytest.skip(lacking)
    with Real(ros, request.param, tmp_path_factory.mktemp("real")) as real:
        real.until_active(1)
        yield real


@pytest.fixture
def real(launched: Real) -> Real:
    """Its wheels turn."""
    assert launched.drive()
    launched.trial.board.events()
    return launched


def comes_back(real: Real, active: int) -> None:
    """It is started again and commands as before, and nothing moves before an enable."""
    real.until_active(active + 1)
    time.sleep(OBEYS_S)
    assert not real.trial.robot.state.enabled
    assert not any(event.is_motion for event in real.trial.board.events())


@pytest.mark.parametrize("fault", DEATHS)
def test_its_death_stops_the_wheels_and_the_next_one_moves_nothing(real: Real, fault: str) -> None:
    active = real.active()
    seen = struck(real, fault)
    assert seen.still_ns is not None
    assert seen.still_ns < HUNG_NS
    assert seen.motion_after == 0
    comes_back(real, active)


@pytest.mark.parametrize("fault", ["SIGINT", "SIGTERM"])
def test_an_interrupt_stops_the_wheels(real: Real, fault: str) -> None:
    """The plugin disables motion. At the guard port a driver that writes zero and ends does not, and the loop may or
    may not write the zero of a controller that has been deactivated."""
    active = real.active()
    seen = struck(real, fault)
    assert seen.still_ns is not None
    assert seen.motion_after == 0
    assert real.trial.robot.state.estop is None
    if real.plugin == OURS or not real.trial.robot.state.enabled:
        comes_back(real, active)
    else:
        real.until_active(active + 1)


@pytest.mark.parametrize("fault", HANGS)
def test_its_hang_stops_the_wheels(real: Real, fault: str) -> None:
    pid, active = real.pid(), real.active()
    try:
        seen = struck(real, fault)
        assert seen.still_ns is not None
        assert seen.still_ns < HUNG_NS
        assert seen.motion_after == 0
    finally:
        os.kill(pid, signal.SIGKILL)
    comes_back(real, active)


def test_an_inactive_hardware_stops_the_wheels(real: Real) -> None:
    """Whether it moves again by itself when it is active again is another question for each of the two."""
    fault_ns = time.monotonic_ns()
    real.set_hardware("inactive")
    seen = stopped(real.trial, fault_ns)
    assert seen.still_ns is not None
    assert seen.motion_after == 0
    if real.plugin == OURS:
        wait_for("motion to be disabled", lambda: not real.trial.robot.state.enabled)
    assert real.trial.robot.state.estop is None
    real.set_hardware("active")


def test_a_controller_that_leaves_stops_the_wheels_and_disables_nothing(real: Real) -> None:
    real.switch("deactivate")
    real.trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert real.trial.robot.state.enabled
    real.switch("activate")
    real.trial.board.wait_wheels(turning=True, timeout_s=20.0)


def test_a_publisher_that_falls_silent_stops_the_wheels_and_drives_on(real: Real) -> None:
    real.publisher.signal(signal.SIGSTOP)
    try:
        real.trial.board.wait_wheels(turning=False, timeout_s=5.0)
        assert real.trial.robot.state.enabled
    finally:
        real.publisher.signal(signal.SIGCONT)
    real.trial.board.wait_wheels(turning=True, timeout_s=20.0)


def test_a_latched_stop_is_held_until_reset_and_enable(real: Real) -> None:
    pid = real.pid()
    real.trial.robot.estop("a test")
    real.trial.board.wait_wheels(turning=False, timeout_s=5.0)
    real.trial.board.events()
    time.sleep(OBEYS_S)
    assert not any(event.is_motion for event in real.trial.board.events())
    real.drive()
    assert real.pid() == pid


def test_the_service_is_started_again(real: Real) -> None:
    pid, before = real.pid(), real.logged.count(FAILED)
    real.trial.leave()
    real.trial.service.end()
    real.trial.board.wait_wheels(turning=False, timeout_s=5.0)
    real.trial.service.start()
    if real.plugin == OURS:
        wait_for("the hardware to have failed", lambda: real.logged.count(FAILED) > before)
        real.set_hardware("active")
        real.switch("activate")
    real.trial.board.events()
    time.sleep(OBEYS_S)
    assert not any(event.is_motion for event in real.trial.board.events())
    real.drive()
    assert real.pid() == pid


def test_a_controller_manager_without_a_service_tries_until_there_is_one(real: Real) -> None:
    """From Jazzy on it ends when its hardware can't be configured, and the launch file starts it again."""
    if real.plugin != OURS:
        pytest.skip("the guard port has a test of its own")
    active, before = real.active(), real.logged.count(WAITS)
    real.trial.leave()
    os.kill(real.pid(), signal.SIGKILL)
    real.trial.service.end()
    wait_for("the second one to wait", lambda: real.logged.count(WAITS) >= before + 2, STARTS_S)
    real.trial.service.start()
    real.until_active(active + 1)
    real.drive()


def test_what_the_controllers_publish(real: Real) -> None:
    """By the encoders of the board, or by what it answers to the driver."""
    time.sleep(OBEYS_S)  # past the ramp
    speed = ("--field", "twist.twist.linear.x", "/base_controller/odom", "nav_msgs/msg/Odometry")
    odometry = real.ros.run(*ECHO, *speed)
    # diffdrive_arduino divides each step of the counts by the period of its loop, so its speeds jitter.
    assert float(odometry.split()[0]) == pytest.approx(MPS, rel=0.1 if real.plugin == OURS else 0.5)
    if real.plugin == OURS:
        states = real.ros.run(*ECHO, "/dynamic_joint_states", "control_msgs/msg/DynamicJointState")
        for name in ("enabled", "latched", "blocked", "turning", "voltage"):
            assert f"- {name}\n" in states
