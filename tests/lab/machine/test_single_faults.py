"""Every single fault of one scenario, in short: `failstop simulate` has them all."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import replace

import pytest

from failstop.cli.main import main
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import traits_of
from failstop_lab.simulate import coverage, single_faults
from failstop_lab.simulate.controls import CONTROLS, Mutant
from failstop_lab.simulate.scenarios import SCENARIOS, scenarios_of
from failstop_lab.simulate.single_faults import Plan
from failstop_lab.simulate.stage import Stage

pytestmark = pytest.mark.slow
FOUND = ("own stop does not refuse motion", "one stop frame for a burst", "a sleep of the machine goes unnoticed")
DAY_S = 86_400
PARTS = 2
PLAYED = (
    "the port owner does not notice that the gate is silent",
    "nobody fences",
    "the stopper does not fence",
    "the stopper does not notice that the port owner is silent",
    "ready before the port owner's answer",
    "a program drives on through an enable",
)
"""Controls that their scenario needs no fault for."""


def explored(plan: Plan) -> single_faults.Result:
    """The plan's result, from a process of its own: a fork of one with all tests in its memory takes twice as long."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(single_faults.explore, (plan,))


def test_no_single_fault_turns_a_wheel_or_keeps_the_service_down() -> None:
    """One call of each line: each day another of the campaign's plans, and of that one call in PARTS. A plan for what
    many scenarios begin with has few calls, each of which is tried in all of them."""
    todo = single_faults.plans(scenarios_of(traits_of(BOARDS[0])), 1)
    part, number = divmod(int(time.time()) // DAY_S, len(todo))
    share, shares = todo[number].share
    parts = 1 if len(todo[number].branches) > 1 else PARTS
    found = explored(replace(todo[number], share=(share + part % parts * shares, shares * parts)))
    assert [run.text() for run in found.wrong] == []
    assert found.runs > 10


def test_own_faults_leave_out_the_deaths_of_others() -> None:
    every, own = (explored(Plan("drive", share=(1, 20), most=1, own=own)) for own in (False, True))
    assert 0 < own.runs < every.runs


@pytest.mark.parametrize("control", [each for each in CONTROLS if each.row in FOUND], ids=lambda control: control.row)
def test_a_part_of_the_protocol_that_is_taken_out_is_missed(control: Mutant) -> None:
    found = explored(Plan(control.scenario, most=1, patches=control.patches, fault=control.fault, first=True))
    assert found.wrong
    assert found.wrong[0].story


@pytest.mark.parametrize("row", PLAYED)
def test_a_scenario_misses_what_is_taken_out(row: str) -> None:
    control = next(each for each in CONTROLS if each.row == row)
    stage = Stage(SCENARIOS[control.scenario], patches=control.patches)
    stage.run()
    assert stage.witness.violations


def test_a_fault_that_can_not_happen_at_a_call_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Else a run without a fault would look like one that was harmless."""
    assert main(["simulate", "--scenario", "drive", "--call", "5", "--fault", "nap"]) == 1
    assert capsys.readouterr().err.startswith("failstop: no fault 'nap' can happen at call 5 of drive; ")


def test_what_was_not_reached_is_told() -> None:
    missing = coverage.unreached({"cause died": 1}, traits_of(BOARDS[0]))
    assert "cause hangs" in missing
    assert "cause died" not in missing
    assert not coverage.NOT_TRIED.keys() & set(missing)
