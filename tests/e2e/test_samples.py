"""Samples and settings: what a program that must not miss one reads of a running service."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.messages import box, layout
from tests.support.simulated import MS, PATIENCE_S, Simulated

SETTINGS = {"limits.vx_mps": 0.35, "sources.teleop.priority": 10}


def read_until(simulated: Simulated, robot: Any, wanted: str, count: int) -> list[Any]:
    """Samples of one kind, at least so many: looked for often enough that the newest of each are all."""
    found: list[Any] = []
    until_ns = simulated.now_ns() + round(PATIENCE_S * 1e9)
    while len(found) < count:
        assert simulated.now_ns() < until_ns, f"{len(found)} of {count} of {wanted}"
        simulated.wait(0.001)
        found += [sample for sample in robot.samples() if type(sample).__name__ == wanted]
    return found


def test_every_imu_sample_comes_once_and_in_order(simulated: Simulated) -> None:
    attach = simulated.load("failstop.api.client").attach
    ring = attach(simulated.name, layout.TELEMETRY).ring_reader("box")
    simulated.robot.samples()  # the first call begins
    times = [sample.t_ns for sample in read_until(simulated, simulated.robot, "Imu", 100)]
    written = [entry[1] for entry in iter(ring.next, None) if box.unpack_board(entry[2])[0] == box.IMU_KIND]
    assert times == sorted(times)
    assert len(times) == len(set(times)) == 100
    assert any(written[start : start + len(times)] == times for start in range(len(written)))


def test_values_are_those_of_the_state(simulated: Simulated) -> None:
    (imu, *_) = read_until(simulated, simulated.robot, "Imu", 1)
    assert imu.acceleration_mps2[2] == pytest.approx(9.8, abs=0.8)


def test_odometry_comes_at_50_hz() -> None:
    simulated = Simulated(imu_hz=110.0)
    times = [sample.t_ns for sample in read_until(simulated, simulated.robot, "Odometry", 101)]
    assert (times[-1] - times[0]) / (len(times) - 1) == pytest.approx(20 * MS, rel=0.01)


def test_gamepad_frames(simulated: Simulated) -> None:
    simulated.robot.samples()
    simulated.board.pad(0x0100)
    (pad,) = read_until(simulated, simulated.robot, "Pad", 1)
    assert (pad.buttons, len(pad.axes), pad.mode) == (0x0100, 4, "locked")


def test_a_service_that_was_started_anew_is_read_anew(simulated: Simulated) -> None:
    with simulated.failstop.Robot() as robot:
        read_until(simulated, robot, "Imu", 1)
        simulated.die(layout.SUPERVISOR)
        simulated.recover(layout.SUPERVISOR, 0)
        read_until(simulated, robot, "Imu", 5)


def test_settings_are_those_of_this_run(simulated: Simulated) -> None:
    settings = simulated.robot.settings
    assert settings["limits.vx_mps"] == 0.35
    assert settings["device.path"] == simulated.link
    assert settings["scan.gate"] == "on"
    assert settings["sources.teleop.timeout_s"] == 0.3
