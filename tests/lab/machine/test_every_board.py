"""The simulated machine with each board's receiver: faults that are drawn, and one part of its own stop taken out."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.board.kinds import KINDS
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import (
    HAS_ARM,
    HAS_DRIVERS,
    HAS_IMU,
    HAS_KEYS,
    HAS_REPORTS,
    HAS_WHEEL_REPORTS,
    traits_of,
)
from failstop_lab.simulate.controls import CONTROLS, Mutant
from failstop_lab.simulate.faults import REPORT_FAULTS
from failstop_lab.simulate.scenarios import SCENARIOS, scenarios_of
from failstop_lab.simulate.seeds import Nursery
from failstop_lab.simulate.single_faults import Plan, explore
from failstop_lab.simulate.stage import NEEDS, Stage
from tests.support.amounts import LONG, amount
from tests.support.boards import EVERY_KIND, own_folder

pytestmark = pytest.mark.slow
DRAWN = ["port_owner_dies"]
OF_OTHERS = [each for each in CONTROLS if each.board != BOARDS[0]]
OF_WHEELS = ("wheel_runs_away", "wheels_turn_unasked")
"""Scenarios of a board that reports its wheels."""
CHEAP = "a stop is not repeated"


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_no_drawn_fault_turns_a_wheel_of_any_board(kind: str) -> None:
    """Of one scenario in short; `failstop simulate --board` has all, and every single fault."""
    nursery = Nursery(None if LONG else DRAWN, board=kind, rounds=amount(3, 12))
    runs = [nursery.run(seed) for seed in range(amount(2, 300))]
    assert [run.text() for run in runs if run.violations] == []
    assert sum(sum(run.groups.values()) for run in runs) > len(runs)


@pytest.mark.parametrize(
    "control", [each for each in OF_OTHERS if LONG or each.row == CHEAP], ids=lambda control: control.row
)
def test_a_part_of_a_boards_own_stop_that_is_taken_out_is_missed(control: Mutant) -> None:
    plan = Plan(control.scenario, most=1, patches=control.patches, fault=control.fault, first=True, board=control.board)
    assert explore(plan).wrong


def _starves_behind_a_lost_stop(stage: Stage) -> None:
    robot, model = stage.connect(), stage.robot.board.model
    stage.enable(robot)
    stage.drive(robot, 0.5)
    model.deaf = True
    robot.disable()
    stage.time.sleep(0.001)
    stage.freeze("port_owner", 2_000, starved=True)
    model.deaf = False
    stage.time.sleep(2.5)


def test_a_port_owner_that_starves_behind_a_lost_stop_is_not_spared() -> None:
    stage = Stage(_starves_behind_a_lost_stop, kind="hoverboard")
    stage.run()
    assert stage.witness.violations == []
    assert "port_owner died" in stage.witness.causes


@pytest.mark.starts
def test_a_board_in_a_folder_of_ones_own_drives_on_it(tmp_path: Path) -> None:
    stage = Stage(SCENARIOS["replug"], kind=own_folder(tmp_path / "tank"))
    stage.run()
    assert stage.witness.violations == []
    assert stage.witness.causes == ["device lost"]


def test_a_scenario_needs_what_a_board_has_by_its_description() -> None:
    whole, *described = (traits_of(kind) for kind in BOARDS)
    guarded = [name for name, play in SCENARIOS.items() if HAS_DRIVERS in NEEDS[play]]
    assert scenarios_of(whole) == [name for name in SCENARIOS if name not in OF_WHEELS]
    for traits in described:
        assert not traits.parts & {HAS_ARM, HAS_KEYS, HAS_IMU}
        lacks = {HAS_ARM: 1, HAS_KEYS: 1, HAS_REPORTS: 2, HAS_WHEEL_REPORTS: len(OF_WHEELS), HAS_DRIVERS: len(guarded)}
        assert len(SCENARIOS) - len(scenarios_of(traits)) == sum(lacks[part] for part in lacks.keys() - traits.parts)


@pytest.mark.parametrize("fault", REPORT_FAULTS)
@pytest.mark.parametrize("kind", KINDS)
def test_no_stop_waits_for_a_report_or_is_lost_by_one(kind: str, fault: str) -> None:
    """The reports stop, are late, or lie, at each reading of some scenarios; the board's wheels judge."""
    for scenario in scenarios_of(traits_of(kind)) if LONG else ("drive_and_stop", "reports_lie"):
        found = explore(Plan(scenario, most=1, fault=fault, board=kind))
        assert [run.text() for run in found.wrong] == []
        assert found.runs > 1


@pytest.mark.parametrize(
    "control", [each for each in OF_OTHERS if each.scenario in OF_WHEELS], ids=lambda each: each.row
)
def test_a_judge_of_wheels_that_is_taken_out_is_missed(control: Mutant) -> None:
    for patches, wrong in ((control.patches, True), ((), False)):
        stage = Stage(SCENARIOS[control.scenario], patches=patches, kind=control.board)
        stage.run()
        assert bool(stage.witness.violations) == wrong
