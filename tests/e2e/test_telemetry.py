"""What the board sends reaches the state that clients read."""

from __future__ import annotations

import pytest

from failstop.trial import Trial, wait_for


def test_imu_and_battery(trial: Trial) -> None:
    wait_for("an IMU sample", lambda: trial.robot.state.imu is not None)
    wait_for("the battery", lambda: trial.robot.state.battery_mv is not None)
    imu = trial.robot.state.imu
    assert imu is not None
    assert imu["acceleration_mps2"][2] == pytest.approx(9.8, abs=0.8)
    assert all(abs(rate) < 0.2 for rate in imu["rate_radps"])
    assert 5000 < (trial.robot.state.battery_mv or 0) < 15000


def test_imu_goes_on_while_driving(trial: Trial) -> None:
    trial.enable()
    wait_for("an IMU sample", lambda: trial.robot.state.imu is not None)
    seen = set()
    for _ in range(20):
        trial.drive(0.03)
        imu = trial.robot.state.imu
        assert imu is not None
        seen.add(tuple(imu["rate_radps"]))
    assert len(seen) > 10
