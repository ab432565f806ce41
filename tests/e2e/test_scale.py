"""A scale of the wheels that is wrong: capped until somebody has confirmed it, told by the first drive where the board
or the gyro measures speeds by itself. The judge is the simulated board."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest

from failstop.board.kinds import KINDS, board_of
from failstop.policy.scale import ASSUMED, CAPS
from failstop_lab.boards.live import DIAMETER_M
from tests.support.simulated import Simulated

STEP_S = 0.05
USUAL = {kind: board_of(kind, DIAMETER_M, 0.0).per_rps for kind in KINDS}
"""One turn a second of a wheel as such boards usually have it, and the simulated ones do."""
FACTORS = (0.2, 0.4, 0.5, 0.7, 1.5, 2.0, 2.5, 6.0)


def scaled(kind: str, too_large: float, *, confirmed: bool = False) -> dict[str, object]:
    """The settings of a scale that is so many times too large."""
    per_rps = USUAL[kind] * too_large
    return {"board.per_rps": per_rps, "board.per_rps_confirmed": per_rps if confirmed else 0.0}


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


def events(simulated: Simulated) -> list[tuple[str, str]]:
    """The level and the text of each event about the scale."""
    log = simulated.load("failstop.api.events").EventLog(simulated.name)
    return [(event.level, event.text) for event in log.read() if event.kind == "scale"]


def test_a_robot_whose_scale_nobody_has_confirmed_is_capped_and_says_so() -> None:
    simulated = Simulated({"board.per_rps": 0.0, "board.per_rps_confirmed": 0.0}, kind="arduino")
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


@pytest.mark.parametrize("too_large", FACTORS)
def test_a_scale_that_a_person_has_only_written_is_capped(too_large: float) -> None:
    simulated = Simulated(scaled("arduino", too_large), kind="arduino")
    assert str(simulated.robot.enable()).startswith("motion enabled; speed capped at 0.05 m/s")
    assert driven(simulated, 0.2) <= too_large * CAPS["limits.vx_mps"] * 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_so_it_is_at_every_board_and_a_number_that_was_confirmed_lifts_no_cap_for_another(kind: str) -> None:
    for confirmed in (0.0, USUAL[kind]):
        settings = {**scaled(kind, 0.5), "board.per_rps_confirmed": confirmed}
        simulated = Simulated(settings, kind=kind)
        assert "; speed capped at 0.05 m/s" in str(simulated.robot.enable())
    simulated = Simulated(scaled(kind, 0.8, confirmed=True), kind=kind)
    assert simulated.robot.enable() == "motion enabled"


def test_a_limit_below_the_cap_stays_as_it_is() -> None:
    simulated = Simulated({"board.per_rps": 0.0, "board.per_rps_confirmed": 0.0, "limits.vx_mps": 0.03}, kind="arduino")
    simulated.robot.enable()
    assert driven(simulated, 0.2) == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("kind", ["rrc", "arduino", "damiao", "feetech", "hoverboard", "ugv", "vesc"])
def test_a_scale_that_is_known_is_not_capped(kind: str) -> None:
    """By the setting, by the board itself, or by its reports."""
    simulated = Simulated(kind=kind)
    assert simulated.robot.enable() == "motion enabled"
    assert simulated.robot.state.scale.capped == ""


@pytest.mark.parametrize("kind", ["hoverboard", "ugv"])
@pytest.mark.parametrize("too_large", FACTORS)
def test_the_first_drive_tells_by_reports_of_their_own(too_large: float, kind: str) -> None:
    """A hoverboard sets a voltage, so what a slope may explain is no warning there. A UGV reports whole centimetres, so
    a difference of a third shows only after two seconds."""
    simulated = Simulated(scaled(kind, too_large, confirmed=True), kind=kind)
    simulated.robot.enable()
    driven(simulated, 0.2, seconds=2.0 if kind == "ugv" else 1.0)
    found: Any = simulated.robot.state.scale
    (said,) = found.wrong + found.remarks
    assert "times as fast as they are told, as the board reports them" in said
    would = float(said.partition("board.per_rps = ")[2].partition(" ")[0])
    assert would == pytest.approx(USUAL[kind], rel=0.3)
    assert f"(now {USUAL[kind] * too_large:.4g})" in said
    told = {level for level, text in events(simulated) if "times as fast as they are told" in text}
    if kind == "ugv" or not 0.4 < too_large < 3.0:
        assert found.wrong
    elif 0.6 < too_large < 1.7:
        assert found.remarks
    assert told >= {"warning" if found.wrong else "info"}
    if found.wrong:
        for screen in ("status", "why"):
            assert "board.per_rps = " in simulated.printed(screen)


def test_a_turn_tells_by_the_gyro() -> None:
    simulated = Simulated({"wheels.track_m": 0.9, "wheels.wheelbase_m": 0.18})
    simulated.wait(4.0)  # until the gyro's bias is known
    simulated.robot.enable()
    driven(simulated, 0.0, 0.5, 3.0)
    (wrong,) = simulated.robot.state.scale.wrong
    assert "as the gyro measures it: one of wheels.track_m" in wrong


def test_a_scale_that_fits_is_told_as_a_number() -> None:
    simulated = Simulated(kind="ugv")
    simulated.robot.enable()
    driven(simulated, 0.2)
    found = simulated.robot.state.scale
    assert found.wheels == pytest.approx(1.0, abs=0.1)
    assert found.wrong == ()
