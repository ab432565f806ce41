"""Samples and settings: what a program that must not miss one reads of a running service."""

from __future__ import annotations

import itertools
import os

import pytest

from failstop import Robot
from failstop.api.client import attach
from failstop.api.snapshot import Imu, Odometry, Pad, Sample
from failstop.lab.trial import Trial, wait_for
from failstop.shm import box, layout


def read_until(robot: Robot, wanted: type, count: int) -> list[Sample]:
    found: list[Sample] = []

    def enough() -> bool:
        found.extend(robot.samples())
        return sum(isinstance(sample, wanted) for sample in found) >= count

    wait_for(f"{count} of {wanted.__name__}", enough)
    return found


def test_every_imu_sample_comes_once_and_in_order(trial: Trial) -> None:
    robot = trial.robot
    ring = attach(trial.name, layout.TELEMETRY).ring_reader("box")
    robot.samples()  # the first call begins
    times = [sample.t_ns for sample in read_until(robot, Imu, 100) if isinstance(sample, Imu)]
    written = [entry[1] for entry in iter(ring.next, None) if box.unpack_board(entry[2])[0] == box.IMU]
    assert times == sorted(times)
    # What came in one read has one time, so the times alone do not tell a sample that is given twice.
    assert any(written[start : start + len(times)] == times for start in range(len(written)))
    assert len(times) >= 100


def test_values_are_those_of_the_state(trial: Trial) -> None:
    found = read_until(trial.robot, Imu, 1)
    imu = next(sample for sample in found if isinstance(sample, Imu))
    assert imu.acceleration_mps2[2] == pytest.approx(9.8, abs=0.8)


def test_odometry_comes_at_50_hz(trial: Trial) -> None:
    found = read_until(trial.robot, Odometry, 101)
    times = [sample.t_ns for sample in found if isinstance(sample, Odometry)]
    middle_ns = sorted(later - sooner for sooner, later in itertools.pairwise(times))
    assert (times[-1] - times[0]) / (len(times) - 1) == pytest.approx(20e6, rel=0.1), middle_ns


def test_gamepad_frames(trial: Trial) -> None:
    trial.robot.samples()
    trial.board.pad(0x0100, hold=False)
    pad = next(sample for sample in read_until(trial.robot, Pad, 1) if isinstance(sample, Pad))
    assert pad.buttons == 0x0100
    assert len(pad.axes) == 4
    assert pad.mode == "locked"


def test_a_service_that_was_started_anew_is_read_anew(trial: Trial) -> None:
    with Robot(trial.name) as robot:
        read_until(robot, Imu, 1)
        trial.leave()
        trial.service.kill()
        trial.service.start()
        read_until(robot, Imu, 5)


def test_settings_are_those_of_this_run(name: str, tmp_path: os.PathLike[str]) -> None:
    path = os.path.join(tmp_path, "robot.toml")
    with open(path, "w") as file:
        file.write("[limits]\nvx_mps = 0.35\n[sources.teleop]\npriority = 10\n")
    with Trial(name, ("--config", path)) as trial:
        settings = trial.robot.settings
        assert settings["limits.vx_mps"] == 0.35
        assert settings["device.path"] == trial.link
        assert settings["scan.gate"] == "on"
        assert settings["sources.teleop.timeout_s"] == 0.3
