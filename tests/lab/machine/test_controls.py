"""Controls: each part that is taken out is there, the tests that look for it exist, and what a scenario shows by
itself is missed at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop_lab.machine.loading import patched
from failstop_lab.simulate.control_runs import BOTH, controls_of, file_of, found_by, page
from failstop_lab.simulate.controls import CONTROLS, Mutant
from failstop_lab.simulate.scenarios import SCENARIOS
from failstop_lab.simulate.stage import Stage
from failstop_lab.simulate.tested_controls import TESTED, ByTest, Noticed, copied, search

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/reference/controls.md").read_text("utf-8")
BY_ITSELF = (
    "a run begins without a stop",
    "a board that is back is not stopped first",
    "bytes in the stop pipe do not stop the robot",
    "the board's stop key does not stop the robot",
    "the service does not notice that its stop pipe was removed",
    "the command of a dead driver stays valid",
    "a command that is not a number is accepted",
    "two programs may command under one source",
    "records with a wrong CRC are accepted",
    "a driver's death leaves motion enabled",
    "a lost interlock does not disable motion",
    "a silent obstacle sensor does not block motion",
    "an operator who is no longer heard does not stop the robot",
    "zero is not repeated to a stopped board",
    "a disable leaves motion enabled",
    "speeds above the limit are not reduced",
    "a driver's death at the guard port goes unnoticed",
    "a process that has died is not started again",
)
"""What its scenario shows without any fault."""
QUICK = "the answer to a ping from before the stop acknowledges the stop"


@pytest.mark.parametrize("control", [*BOTH, *TESTED], ids=lambda control: control.row)
def test_what_is_taken_out_is_there_once(control: Mutant | ByTest) -> None:
    for module in {module for module, _, _ in control.patches}:
        source = (ROOT / file_of(module)).read_text("utf-8")
        assert patched(module, source, control.patches) != source


@pytest.mark.parametrize("control", TESTED, ids=lambda control: control.row)
def test_the_test_of_a_control_exists(control: ByTest) -> None:
    file, _, function = control.test.partition("::")
    assert f"def {function.partition('[')[0]}(" in (ROOT / file).read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("control", [each for each in CONTROLS if each.row in BY_ITSELF], ids=lambda each: each.row)
def test_a_scenario_shows_what_is_taken_out(control: Mutant) -> None:
    for patches, wrong in ((control.patches, True), ((), False)):
        stage = Stage(SCENARIOS[control.scenario], patches=patches, kind=control.board)
        stage.run()
        assert bool(stage.witness.violations) == wrong, stage.witness.violations


def test_every_row_that_a_scenario_shows_is_a_control() -> None:
    assert set(BY_ITSELF) <= {each.row for each in CONTROLS}


@pytest.mark.slow
@pytest.mark.starts
def test_a_test_notices_what_is_taken_out_of_a_copy() -> None:
    control = next(each for each in TESTED if each.row == QUICK)
    found = search(control)
    assert found.wrong
    assert f"`{control.test}`" in found.text()


@pytest.mark.starts
def test_a_copy_is_changed_and_the_checkout_is_not(tmp_path: Path) -> None:
    control = next(each for each in TESTED if each.row == QUICK)
    copied(tmp_path, control.patches)
    [(module, old, new)] = control.patches
    assert new in (tmp_path / file_of(module)).read_text("utf-8")
    assert old in (ROOT / file_of(module)).read_text("utf-8")


def test_the_page_tells_what_was_found_what_was_not_and_what_nobody_looked_for() -> None:
    first, second, third = TESTED[:3]
    found = Noticed(first, 1.26, "assert 1 == 2", "", "abc")
    missed = Noticed(second, 2.0, "", "", "abc")
    bare = "\n".join(line for line in PAGE.splitlines() if f"| {third.row} |" not in line)
    told = page((found, missed), bare)
    assert found_by(first, told) == (f"`{first.test}`", "1.3")
    assert found_by(second, told) == ("", "")
    assert found_by(third, told) == ("", "")
    assert page((), told) == told


def test_the_controls_of_a_claim_are_those_that_name_it() -> None:
    assert [each.row for each in controls_of("SILENCE-1")] == ["a board that falls silent does not stop the robot"]
    assert controls_of("NEW-1") == []
