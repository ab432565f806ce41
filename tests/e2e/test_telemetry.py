"""What the board sends reaches the state that clients read."""

from __future__ import annotations

import pytest

from failstop.lab.trial import Trial, wait_for


def test_imu_and_battery(trial: Trial) -> None:
    wait_for("an IMU sample", lambda: trial.robot.state.imu is not None)
    wait_for("the battery", lambda: trial.robot.state.battery_v is not None)
    imu = trial.robot.state.imu
    assert imu is not None
    assert imu.acceleration_mps2[2] == pytest.approx(9.8, abs=0.8)
    assert all(abs(rate) < 0.2 for rate in imu.rate_radps)
    assert 5 < (trial.robot.state.battery_v or 0) < 15


def test_imu_goes_on_while_driving(trial: Trial) -> None:
    trial.enable()
    wait_for("an IMU sample", lambda: trial.robot.state.imu is not None)
    seen = set()
    for _ in range(20):
        trial.drive(0.03)
        imu = trial.robot.state.imu
        assert imu is not None
        seen.add(tuple(imu.rate_radps))
    assert len(seen) > 10


def test_gyro_bias_is_found_at_the_start_and_told(trial: Trial) -> None:
    wait_for("the calibration", lambda: (bias := trial.robot.state.gyro_bias) and bias.calibrated, 10.0)
    wait_for("the line that says so", lambda: "gyro" in trial.service.said())


def test_odometry_follows_the_gated_command(trial: Trial) -> None:
    trial.enable()
    trial.drive(1.0)
    trial.drive(0.2, (0.0, 0.0, 0.0))
    pose = trial.robot.state.odometry
    assert pose is not None
    # The ramp takes 0.4 s up to 0.2 m/s and as long down; the rest is at speed.
    assert 0.10 < pose.x_m < 0.22
    assert pose.y_m == pytest.approx(0.0, abs=1e-6)


def test_a_killed_telemetry_goes_on_where_it_was(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.6)
    before = trial.robot.state.odometry
    pid = trial.service.pids()["telemetry"]
    trial.kill("telemetry", 0.0)
    trial.recover("telemetry", pid)
    pose = trial.robot.state.odometry
    assert before is not None
    assert pose is not None
    assert pose.x_m >= before.x_m > 0
