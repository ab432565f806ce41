"""What the state holds, how often it is new, and what the journal says of a stop."""

from __future__ import annotations

import fcntl
import itertools
import os
import struct
import time
from collections.abc import Callable, Iterator

import pytest

from failstop.lab.trial import Trial, wait_for
from failstop.shm.cell import LatestReader

TIOCGEXCL = 0x80045440


@pytest.fixture(scope="module")
def service() -> Iterator[Trial]:
    with Trial(f"e2e-{os.getpid()}-state") as running:
        yield running


def renewals(reader: LatestReader, seconds: float, each: Callable[[], None] = lambda: None) -> list[int]:
    """When a record was new, by its own times (ns)."""
    found: list[int] = []
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        entry = reader.read()
        if entry and (not found or entry[1] > found[-1]):
            found.append(entry[1])
        each()
        time.sleep(0.001)
    return found


def rate_hz(times_ns: list[int]) -> float:
    return (len(times_ns) - 1) / (times_ns[-1] - times_ns[0]) * 1e9


def test_one_process_opens_the_port_exclusively(service: Trial) -> None:
    fd = os.open(service.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        answer = fcntl.ioctl(fd, TIOCGEXCL, struct.pack("i", 0))
    finally:
        os.close(fd)
    assert struct.unpack("i", answer) == (1,)


def test_the_imu_is_new_about_110_times_a_second(service: Trial) -> None:
    wait_for("a sample", lambda: service.robot.state.imu is not None)
    assert 90 < rate_hz(renewals(service.robot._current()._latest["imu"], 1.0)) < 120


def test_what_is_not_known_is_not_told(service: Trial) -> None:
    """No orientation estimate; of the battery the voltage and no percentage."""
    wait_for("the battery", lambda: service.robot.state.battery_v is not None)
    wait_for("a sample", lambda: service.robot.state.imu is not None)
    found = service.robot.state.as_dict()
    assert set(found["imu"]) == {"t_ns", "acceleration_mps2", "rate_radps", "rate_variance"}
    assert {key for key in found if "battery" in key or "percent" in key} == {"battery_v"}
    assert found["plugged"] == "unknown", "until a step is seen"


def test_the_state_has_everything(service: Trial) -> None:
    service.enable()
    service.drive(0.6)
    service.board.pad(0)
    wait_for("the pad", lambda: service.robot.state.pad_mode is not None)
    wait_for("the bias", lambda: service.robot.state.gyro_bias is not None)
    service.drive(0.1)
    state = service.robot.state
    assert (state.enabled, state.estop, state.blocked) == (True, None, None)
    assert state.body_vel == pytest.approx((0.2, 0.0, 0.0))
    assert state.scan_age_s is not None
    assert state.gyro_bias is not None
    assert state.gyro_bias.tracking is False, "frozen while driving"
    assert (state.pad_mode, state.plugged) == ("locked", "unknown")
    assert state.sources[0].who == f"trial (pid {os.getpid()})", "the publisher"
    assert state.device.state == "open"
    assert state.device.link in ("unproven", "alive")
    assert all(row.pid > 0 and row.age_s >= 0 and row.restarts >= 0 for row in state.processes.values())
    assert state.odometry is not None
    assert state.odometry.pose_variance == 1e3
    assert (state.odometry.twist_std_mps, state.odometry.twist_std_radps) == (0.05, 0.2)


@pytest.mark.parametrize("record", ["state", "bias", "odometry"])
def test_the_state_is_new_10_times_a_second_though_nothing_happens(service: Trial, record: str) -> None:
    service.leave()
    reader = service.robot._current()
    assert rate_hz(renewals(reader._latest[record], 2.0)) >= 10


def test_a_latch_is_logged_once_with_its_reason(service: Trial) -> None:
    service.enable()
    before = service.service.said().count("STOP latched: ")
    service.board.key(1, 0x01)
    wait_for("the latch", lambda: service.robot.state.estop == "key1")
    wait_for("the line", lambda: "STOP latched: key1; " in service.service.said())
    service.board.pad(0x0100)
    wait_for("the second stop", lambda: "gamepad button 0x0100; " in service.service.said())
    service.board.pad(0)
    service.drive(0.3)  # the repeats of the burst, and commands that move nothing, are no news
    assert service.service.said().count("STOP latched: ") == before + 1
    assert service.robot.state.estop == "key1"


def test_a_motor_frame_at_least_every_0_2_s_while_driving(service: Trial) -> None:
    service.enable()
    service.drive(0.5)
    service.board.events()
    service.drive(1.0)
    motor = [event.arrival_ns for event in service.board.events() if event.is_motor]
    assert max(after - before for before, after in itertools.pairwise(motor)) < 300e6
    assert len(motor) < 12, "and not at every tick while nothing changes"
