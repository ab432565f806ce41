"""The gate acts at once on a new command and on a stop, not at its next tick: with the slowest tick that is allowed."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.simulated import FORWARD, MS, Simulated

SETTINGS = {"gate.period_s": 0.05}
OFF_S = 0.007
"""No fraction of the period: each try is at another part of it."""
TRIES = 7


def test_on_a_new_command(simulated: Simulated) -> None:
    simulated.enable()
    for _ in range(TRIES):
        simulated.wait(1.0 + OFF_S)
        assert simulated.robot.state.blocked == "cmd timeout"
        simulated.board.events()
        sent_ns = simulated.now_ns()
        simulated.robot.drive(*FORWARD, manual=True)
        event = simulated.board.wait_for(lambda event: event.is_motion)
        assert event.arrival_ns - sent_ns < MS


@pytest.fixture
def unchecked(simulated: Simulated) -> Any:
    """A program that sends what it likes, as one in another language might."""
    return simulated.load("failstop.api.client").Client(simulated.name, "foreign")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_on_a_stop_that_the_gate_makes_itself(simulated: Simulated, unchecked: Any, value: float) -> None:
    for number in range(TRIES):
        simulated.enable()
        for _ in range(10):
            unchecked.command(*FORWARD, manual=True, source="cmd_vel")
            simulated.wait(0.02)
        assert simulated.turning()
        simulated.wait(number * OFF_S)
        simulated.board.events()
        sent_ns = simulated.now_ns()
        unchecked.command(0.0, value, 0.0, manual=True, source="cmd_vel")
        event = simulated.board.wait_for(lambda event: event.is_stop)
        assert event.arrival_ns - sent_ns < MS
        simulated.wait(0.2)
        assert simulated.robot.state.estop == f"command from foreign (pid {simulated.pid}) is not finite"
        assert not simulated.turning()
        assert not any(event.is_motion for event in simulated.board.events())


def test_a_source_that_is_not_declared_is_told_and_moves_nothing(simulated: Simulated, unchecked: Any) -> None:
    simulated.enable()
    unchecked.command(0.1, 0.0, 0.0, manual=True, source="navv")
    simulated.wait_for("the note", lambda: "no source 'navv'" in simulated.said)
    assert not simulated.turning()
