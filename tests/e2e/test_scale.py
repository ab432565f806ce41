"""A scale of the wheels that is wrong: capped until somebody has confirmed it, told by the first drive where the board
or the gyro measures speeds by itself. The judge is the simulated board."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest

from failstop.policy.scale import ASSUMED, CAPS
from failstop_lab.boards.live import DIAMETER_M
from tests.support.simulated import Simulated

STEP_S = 0.05


def driven(simulated: Simulated, forward: float, turn: float = 0.0, seconds: float = 1.0) -> float:
    """The fastest that a wheel rolled, in m/s by the board."""
    fastest = 0.0
    for _ in range(round(seconds / STEP_S)):
        simulated.robot.drive(forward, 0.0, turn, manual=True)
        simulated.wait(STEP_S)
        fastest = max(fastest, *map(abs, simulated.board.wheels()))
    simulated.robot.drive(0.0, 0.0, 0.0, manual=True)
    simulated.wait(0.5)
    return fastest * pi * DIAMETER_M


def events(simulated: Simulated) -> list[str]:
    code, out, _ = simulated.command("events", "--all")
    assert code == 0
    return [line for line in out.splitlines() if " scale " in line]


def test_a_robot_whose_scale_nobody_has_confirmed_is_capped_and_says_so() -> None:
    simulated = Simulated({"board.per_rps": 0.0}, kind="arduino")
    said = str(simulated.robot.enable())
    assert said.startswith("motion enabled; speed capped at 0.05 m/s")
    assert ASSUMED in said
    assert "`failstop setup`" in said
    assert driven(simulated, 0.2) == pytest.approx(CAPS["limits.vx_mps"], rel=0.05)
    state: Any = simulated.robot.state
    assert state.scale.capped == said.removeprefix("motion enabled; ")
    assert simulated.robot.settings["limits.vx_mps"] == CAPS["limits.vx_mps"]
    for screen in ("status", "why"):
        assert "speed capped at 0.05 m/s" in simulated.printed(screen)
    shown = simulated.load("failstop.web.view").view(state, [], 0.0)
    assert any("peed capped at 0.05 m/s" in trouble for trouble in shown["troubles"])


def test_a_limit_below_the_cap_stays_as_it_is() -> None:
    simulated = Simulated({"board.per_rps": 0.0, "limits.vx_mps": 0.03}, kind="arduino")
    simulated.robot.enable()
    assert driven(simulated, 0.2) == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("kind", ["rrc", "arduino", "feetech", "hoverboard", "ugv"])
def test_a_scale_that_is_known_is_not_capped(kind: str) -> None:
    """By the setting, by the board itself, or by its reports."""
    simulated = Simulated(kind=kind)
    assert simulated.robot.enable() == "motion enabled"
    assert simulated.robot.state.scale.capped == ""


@pytest.mark.parametrize("too_large", [0.2, 5.0])
def test_the_first_drive_tells_by_reports_of_their_own(too_large: float) -> None:
    simulated = Simulated({"board.per_rps": 60.0 * too_large}, kind="hoverboard")
    simulated.robot.enable()
    driven(simulated, 0.2)
    (wrong,) = simulated.robot.state.scale.wrong
    assert "times as fast as they are told, as the board reports them: board.per_rps = " in wrong
    assert f"(now {60 * too_large:g})" in wrong
    for screen in ("status", "why"):
        assert "board.per_rps = " in simulated.printed(screen)


def test_a_turn_tells_by_the_gyro() -> None:
    simulated = Simulated({"wheels.track_m": 0.9, "wheels.wheelbase_m": 0.18})
    simulated.wait(4.0)  # until the gyro's bias is known
    simulated.robot.enable()
    driven(simulated, 0.0, 0.5, 3.0)
    (wrong,) = simulated.robot.state.scale.wrong
    assert "as the gyro feels it: one of wheels.track_m" in wrong


def test_a_scale_that_fits_is_told_as_a_number() -> None:
    simulated = Simulated(kind="ugv")
    simulated.robot.enable()
    driven(simulated, 0.2)
    found = simulated.robot.state.scale
    assert found.wheels == pytest.approx(1.0, abs=0.1)
    assert found.wrong == ()
