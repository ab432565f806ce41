"""Driving: what the wheels do for what a client asks, seen by the board of a simulated machine."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest

from tests.support.boards import every_board
from tests.support.simulated import FORWARD, MS, Simulated

AT_SPEED = (0.796, 0.796, -0.796, -0.796)
TICK_NS = 20 * MS
STEPS_NS = MS
"""The calls on the way from the gate to the board, and the wire."""


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


# At once, not at the gate's next tick: with the slowest that is allowed.

OFF_S = 0.007
"""No fraction of the period: each try is at another part of it."""
TRIES = 7


@pytest.fixture
def slow() -> Simulated:
    return Simulated({"gate.period_s": 0.05})


def test_a_new_command_moves_the_wheels_at_once(slow: Simulated) -> None:
    slow.enable()
    for _ in range(TRIES):
        slow.wait(1.0 + OFF_S)
        assert slow.robot.state.blocked == "cmd timeout"
        slow.board.events()
        sent_ns = slow.now_ns()
        slow.robot.drive(*FORWARD, manual=True)
        assert slow.board.wait_for(lambda event: event.is_motion).arrival_ns - sent_ns < MS


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_not_finite_stops_the_wheels_at_once(slow: Simulated, value: float) -> None:
    """Of a program that sends what it likes, as one in another language might."""
    client: Any = slow.load("failstop.api.client").Client(slow.name, "foreign")
    for number in range(TRIES):
        client.command(0.0, 0.0, 0.0, manual=True, source="cmd_vel")
        slow.enable()
        for _ in range(10):
            client.command(*FORWARD, manual=True, source="cmd_vel")
            slow.wait(0.02)
        assert slow.turning()
        slow.wait(number * OFF_S)
        slow.board.events()
        sent_ns = slow.now_ns()
        client.command(0.0, value, 0.0, manual=True, source="cmd_vel")
        slow.wait(0.2)
        slow.stops(sent_ns, 1)
        assert slow.robot.state.estop == f"command from foreign (pid {slow.pid}) is not finite"


def test_sticks_drive_without_a_scan_and_a_button_locks_them(simulated: Simulated) -> None:
    def frames(seconds: float, buttons: int = 0, ly: int = 0) -> None:
        """At 20 Hz, as the board sends them."""
        for _ in range(round(seconds / 0.05)):
            simulated.board.pad(buttons, ly=ly)
            simulated.wait(0.05)

    simulated.enable()
    for buttons in (0, 0x2000, 0):
        frames(0.1, buttons)
    assert simulated.robot.state.pad_mode == "drive"
    frames(0.5, ly=127)
    assert simulated.board.wheels()[0] > 0.1
    assert simulated.robot.state.sources[0].who == "gamepad"
    simulated.board.events()
    pressed_ns = simulated.now_ns()
    frames(0.05, 0x0100, ly=127)
    frames(0.3, ly=127)
    simulated.stops(pressed_ns, 2)
    assert (simulated.robot.state.estop, simulated.robot.state.pad_mode) == ("gamepad button 0x0100", "locked")
