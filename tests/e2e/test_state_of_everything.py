"""The state: its content, how often it is new, and what the journal says of a stop."""

from __future__ import annotations

import pytest

from failstop.messages import layout
from tests.support.simulated import Simulated


def rate_hz(simulated: Simulated, process: str, record: str) -> float:
    """The rate at which a record is new, in two seconds, by its own times."""
    reader = simulated.load("failstop.api.client").attach(simulated.name, process).latest_reader(record)
    found: list[int] = []
    for _ in range(2000):
        entry = reader.read()
        if entry and (not found or entry[1] > found[-1]):
            found.append(entry[1])
        simulated.wait(0.001)
    return (len(found) - 1) / (found[-1] - found[0]) * 1e9


def test_the_imu_is_new_as_often_as_the_board_reports() -> None:
    simulated = Simulated(imu_hz=110.0)
    simulated.wait_for("a sample", lambda: simulated.robot.state.imu is not None)
    assert rate_hz(simulated, layout.TELEMETRY, "imu") == pytest.approx(110.0, abs=1.0)


def test_what_is_not_known_is_not_told(simulated: Simulated) -> None:
    """No orientation estimate; of the battery the voltage and no percentage."""
    simulated.wait_for("the battery", lambda: simulated.robot.state.battery_v is not None)
    found = simulated.robot.state.as_dict()
    assert set(found["imu"]) == {"t_ns", "acceleration_mps2", "rate_radps", "rate_variance"}
    assert {key for key in found if "battery" in key or "percent" in key} == {"battery_v"}
    assert found["plugged"] == "unknown", "until a step is seen"


def test_the_state_has_everything() -> None:
    simulated = Simulated(imu_hz=110.0)
    simulated.wait_for("the bias", lambda: (found := simulated.robot.state.gyro_bias) and found.calibrated)
    simulated.enable()
    simulated.drive(0.6)
    simulated.board.pad()
    simulated.drive(0.1)
    state = simulated.robot.state
    assert (state.enabled, state.estop, state.blocked) == (True, None, None)
    assert state.body_vel == pytest.approx((0.2, 0.0, 0.0))
    assert 0 <= state.scan_age_s < 0.13
    assert (state.gyro_bias.calibrated, state.gyro_bias.tracking) == (True, False), "frozen while driving"
    assert (state.pad_mode, state.plugged) == ("locked", "unknown")
    assert state.sources[0].who == f"trial (pid {simulated.pid})", "the publisher"
    assert (state.device.state, state.device.link) == ("open", "alive")
    assert all(row.pid > 0 and row.age_s >= 0 and row.restarts == 0 for row in state.processes.values())
    assert state.odometry.pose_variance == 1e3
    assert (state.odometry.twist_std_mps, state.odometry.twist_std_radps) == (0.05, 0.2)
    assert 5 < state.battery_v < 15
    assert all(abs(rate) < 0.2 for rate in state.imu.rate_radps)
    assert "gyro" in simulated.said


def test_the_state_is_new_10_times_a_second_though_nothing_happens(simulated: Simulated) -> None:
    for process, record in ((layout.GATE, "state"), (layout.TELEMETRY, "bias"), (layout.TELEMETRY, "odometry")):
        assert rate_hz(simulated, process, record) >= 10, record


def test_a_latch_is_logged_once_with_its_reason(simulated: Simulated) -> None:
    simulated.enable()
    simulated.board.key(1, 0x01)
    simulated.wait_for("the latch", lambda: simulated.robot.state.estop == "key1")
    simulated.board.pad(0x0100)
    simulated.drive(0.3)  # the repeats of the burst, and commands that move nothing, are no news
    assert "STOP latched: key1; " in simulated.said
    assert "gamepad button 0x0100; " in simulated.said
    assert simulated.said.count("STOP latched: ") == 1
    assert simulated.robot.state.estop == "key1"
