"""Driving: what the wheels do for what a client asks, seen by the board of a simulated machine."""

from __future__ import annotations

from math import pi

import pytest

from tests.support.boards import every_board
from tests.support.simulated import FORWARD, MS, Simulated

AT_SPEED = (0.796, 0.796, -0.796, -0.796)
TICK_NS = 20 * MS
STEPS_NS = MS
"""The calls on the way from the gate to the board, and the wire."""


def is_zero(event: object) -> bool:
    """A motor frame after which every wheel stands."""
    return event.is_motor and not any(event.speeds)  # type: ignore[attr-defined]


def test_disabled_at_start(simulated: Simulated) -> None:
    simulated.drive(0.1)
    assert not simulated.turning()
    assert simulated.robot.state.blocked == "disabled"


@pytest.mark.parametrize("asked", [FORWARD, (5.0, 0.0, 0.0)], ids=["forward", "past the limit"])
def test_forward_reaches_the_speeds_of_the_kinematics(simulated: Simulated, asked: tuple[float, float, float]) -> None:
    simulated.enable()
    simulated.drive(0.6, asked)
    assert simulated.board.wheels() == pytest.approx(AT_SPEED, abs=0.001)
    assert simulated.robot.state.body_vel == pytest.approx(FORWARD)


def test_ramp_on_the_wire(simulated: Simulated) -> None:
    simulated.enable()
    simulated.board.events()
    begun_ns = simulated.now_ns()
    simulated.drive(0.5)
    frames = [event for event in simulated.board.events() if event.is_motion]
    speeds_mps = [event.speeds[0] * 0.08 * pi for event in frames]
    assert speeds_mps == sorted(speeds_mps)
    assert speeds_mps[-1] == pytest.approx(FORWARD[0])
    assert len(set(speeds_mps)) == 22, "a ramp of 0.4 s: a step each tick, and one of less at either end"
    for event, speed_mps in zip(frames, speeds_mps, strict=True):
        assert speed_mps <= 0.5 * ((event.arrival_ns + TICK_NS - begun_ns) / 1e9) + 1e-6


def test_command_timeout(simulated: Simulated) -> None:
    simulated.set_off()
    last_ns = simulated.now_ns()
    simulated.robot.drive(*FORWARD)
    event = simulated.board.wait_for(lambda e: is_zero(e) and e.arrival_ns > last_ns)
    assert 300 * MS <= event.arrival_ns - last_ns <= 300 * MS + STEPS_NS
    simulated.wait_for("the block reason", lambda: simulated.robot.state.blocked == "cmd timeout")
    assert simulated.robot.state.enabled


@every_board
def test_disable_stops_at_once(simulated: Simulated) -> None:
    simulated.set_off()
    asked_ns = simulated.now_ns()
    assert simulated.robot.disable() == "motion disabled"
    simulated.drive(0.1)
    found = [event for event in simulated.board.events() if event.is_motor]
    while found[0].is_motion and found[0].executed_ns <= asked_ns + simulated.own_ns:
        del found[0]  # it was on the line
    stop, *rest = found
    assert stop.is_stop
    assert stop.arrival_ns - asked_ns <= STEPS_NS + simulated.own_ns
    assert not any(event.is_motion for event in rest)
    state = simulated.robot.state
    assert (state.blocked, state.estop) == ("disabled", None)
