"""Sources, scan gate, interlocks, on a simulated machine: what the board's wheels do, what the state says."""

from __future__ import annotations

import pytest

from tests.support.simulated import FORWARD, MS, Simulated

SETTINGS = {
    "sources.cmd_vel.priority": 0,
    "sources.teleop.priority": 10,
    "sources.teleop.timeout_s": 0.3,
    "interlocks.arm.timeout_s": 0.4,
    "interlocks.arm.refusal": "arm is not in the drive pose",
}
TICK_NS = 20 * MS


@pytest.fixture
def plain() -> Simulated:
    """A service with the default settings."""
    return Simulated()


def hold(simulated: Simulated, seconds: float) -> None:
    """Drive with the interlock held."""
    simulated.drive(seconds, each=lambda: simulated.robot.hold("arm"))


def enable(simulated: Simulated) -> None:
    simulated.robot.hold("arm")
    simulated.wait(0.001)
    simulated.robot.enable()


def test_no_scan_stops_and_resumes_by_itself(plain: Simulated) -> None:
    plain.set_off()
    plain.robot.sensed()
    seen_ns = plain.now_ns()
    for _ in range(40):
        plain.robot.drive(*FORWARD)
        plain.wait(0.02)
    state = plain.robot.state
    assert (state.enabled, state.estop, state.blocked) == (True, None, "no scan")
    assert state.body_vel == (0.0, 0.0, 0.0)
    assert state.scan_age_s == pytest.approx((plain.now_ns() - seen_ns) / 1e9, abs=0.001)
    still = next(event for event in plain.board.events() if event.is_motor and not any(event.speeds))
    assert 500 * MS <= still.arrival_ns - seen_ns <= 500 * MS + TICK_NS
    assert not plain.moving()
    plain.drive(0.2)
    assert plain.moving(), "motion resumes by itself"
    assert plain.robot.state.blocked is None
    assert "no scan for 0.5" in plain.said
    assert "scan is back" in plain.said


def test_manual_commands_need_no_scan(plain: Simulated) -> None:
    plain.enable()
    for _ in range(50):
        plain.robot.drive(*FORWARD, manual=True)
        plain.wait(0.02)
    assert plain.moving()


def test_interlock_is_needed_to_enable_and_its_loss_disables(simulated: Simulated) -> None:
    refused = simulated.failstop.Refused
    with pytest.raises(refused, match="arm is not in the drive pose"):
        simulated.robot.enable()
    enable(simulated)
    hold(simulated, 0.3)
    assert simulated.moving()
    simulated.board.events()
    lost_ns = simulated.now_ns()
    simulated.drive(0.6)
    assert not simulated.moving()
    stop = next(event for event in simulated.board.events() if event.is_stop)
    assert 400 * MS - TICK_NS <= stop.arrival_ns - lost_ns <= 400 * MS + TICK_NS
    state = simulated.robot.state
    assert (state.enabled, state.blocked, state.estop) == (False, "disabled", None)
    assert "motion disabled: arm is not in the drive pose" in simulated.said
    code, out, err = simulated.command("enable")
    refusal = "failstop: refused: arm is not in the drive pose; next: see to that interlock, then `failstop enable`\n"
    assert (code, out, err) == (2, "", refusal)
    todo = ["see to the interlock (arm is not in the drive pose)", "`failstop enable`"]
    assert simulated.json("why")["do"] == todo
    with pytest.raises(simulated.failstop.TimedOut, match=r"see to the interlock \(arm is not in the drive pose\)"):
        simulated.robot.wait_for("ready", 0.0)


def test_a_higher_source_takes_over_and_gives_back(simulated: Simulated) -> None:
    enable(simulated)
    with simulated.failstop.Robot(client="person") as person:
        for _ in range(15):
            hold(simulated, 0.02)
            person.drive(-0.1, 0.0, 0.0, manual=True, source="teleop")
        assert simulated.board.wheels()[0] < 0
        state = simulated.robot.state
        assert [(row.source, row.state) for row in state.sources][:1] == [("teleop", "drives")]
        assert state.estop is None
    hold(simulated, 0.7)
    assert simulated.board.wheels()[0] > 0
