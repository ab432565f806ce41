"""Seeds: the decisions of a run reproduce it, and a failure is reported with the draws that it needs."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest

from failstop.cli.main import main
from failstop_lab.machine.files import Regular
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.simulate import control_runs, controls, seeds
from failstop_lab.simulate.control_runs import BOTH
from failstop_lab.simulate.controls import CONTROLS
from failstop_lab.simulate.decisions import Decisions, Draws, shrunk
from failstop_lab.simulate.events import DRAWN_EVENTS, GROUPS
from failstop_lab.simulate.hot_records import RECORDS, HotRecords
from failstop_lab.simulate.seeds import Nursery, Seeded
from failstop_lab.simulate.tested_controls import TESTED

OWN_STOP = next(each for each in CONTROLS if each.row == "own stop does not refuse motion")
MOST_DRAWS = 6
QUICK = ("reply: client", "unknown: supervisor")
HEADS = (control_runs.COLUMNS[0], control_runs.OF_CLAIMS[0], "row")


def test_a_tape_gives_again_what_was_drawn_and_nothing_else() -> None:
    labels = [f"event {number}" for number in range(20)]
    drawn = Decisions(7)
    values = {label: drawn.draw(label, 1000, 0.9) for label in labels}
    again = Decisions(8, drawn.drawn)
    assert {label: again.draw(label, 1000, 0.9) for label in labels} == values
    assert again.drawn == drawn.drawn
    assert again.draw("another", 1000) == 0
    assert len(set(values.values())) > 10


@pytest.mark.parametrize("value", [-1, 3, 10**400])
def test_a_draw_that_cannot_be_is_nothing_odd(value: int) -> None:
    assert Decisions(0, {"a": value}).draw("a", 3) == 0


@pytest.mark.parametrize(
    "made_up",
    [
        b"",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"draws": []}',
        b'{"draws": {"settings": Infinity}}',
        b'{"draws": {"settings": NaN}}',
        b'{"draws": {"settings": "gate"}}',
        b'{"draws": {"settings": ' + b"9" * 5000 + b"}}",
    ],
)
def test_a_file_that_is_no_tape_is_told(made_up: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "decisions").write_bytes(made_up)
    assert main(["simulate", "--decisions", str(tmp_path / "decisions")]) == 1
    assert "this is not a list of decisions: copy everything between the quotes" in capsys.readouterr().err


@pytest.mark.parametrize("needed", [{"a"}, {"c", "j"}, {"a", "e", "h"}, set()])
def test_what_is_shrunk_keeps_the_draws_that_are_needed(needed: set[str]) -> None:
    draws = {label: number for number, label in enumerate("abcdefghij", 1)}

    def fails(some: Draws) -> Draws | None:
        return some if needed <= some.keys() else None

    assert shrunk(draws, fails).keys() == needed


def test_every_kind_has_a_number_of_its_own() -> None:
    assert len(set(DRAWN_EVENTS)) == len(DRAWN_EVENTS) == sum(map(len, GROUPS.values()))


@pytest.mark.slow
def test_a_seed_is_the_same_run_again_by_its_decisions() -> None:
    nursery = Nursery(["gate_dies"], rounds=2)
    run = nursery.run(0)
    again = nursery.run(100, run.draws)
    assert run.groups
    assert (again.digest, again.draws, again.groups) == (run.digest, run.draws, run.groups)
    assert nursery.run(0, {}).digest != run.digest


@pytest.mark.slow
def test_a_failure_keeps_only_the_draws_that_it_needs() -> None:
    """The stop of the port owner's own is what the stop request is answered by."""
    found = seeds.seeds(0, 1, 60.0, OWN_STOP.patches, [OWN_STOP.scenario], rounds=4)
    run = found.wrong[0]
    assert run.violations
    assert len(run.draws) <= MOST_DRAWS
    assert "again: failstop simulate --scenario supervisor_dies --decisions" in run.text()
    assert json.loads(run.decisions())["draws"] == run.draws


@pytest.mark.slow
@pytest.mark.parametrize("row", QUICK)
def test_a_barrier_that_is_taken_out_is_missed(row: str) -> None:
    control = next(each for each in BOTH if each.row == row)
    found = control_runs.search(control, 60.0)
    assert found.wrong
    assert found.draws <= MOST_DRAWS


def test_the_page_of_controls_has_each_of_them_and_no_other() -> None:
    lines = (Path(__file__).parents[3] / "docs/reference/controls.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split(" | ")[0].removeprefix("| ") for line in lines if line.startswith("| ")]
    wanted = {each.row for each in (*BOTH, *TESTED)} | controls.NOT_EXPRESSED.keys()
    assert sorted(row for row in rows if row not in HEADS and not row.startswith("[")) == sorted(wanted)


def test_a_round_presses_on_records_that_are_there_and_seldomer_in_time() -> None:
    machine = WeakMachine()
    segment = machine.root.folder("/dev/shm")
    epoch = RECORDS[0]
    segment.put(f"failstop.1.{epoch[0]}", file := Regular())
    hot = HotRecords(Random(1), machine, [0])
    hot.begin(memory=True, others=True)
    assert 1 <= sum(hot.comes("load", file, epoch[1].start) for _ in range(1000)) < 600
    assert not any(hot.comes("load", file, epoch[1].stop) for _ in range(100))
    hot.begin(memory=False, others=True)
    assert not any(hot.comes("load", file, epoch[1].start) for _ in range(100))


def test_a_campaign_counts_its_faults() -> None:
    found, other = seeds.Seeds(), seeds.Seeds()
    other.add(Seeded(3, ["1 drive"], violations=["the wheels turn"], groups={"dies": 2, "memory": 5}))
    found.merge(other)
    assert (found.runs, found.rounds, found.events) == (1, 1, 7)
    assert found.wrong[-1].seed == 3


def test_what_no_change_of_the_source_stands_for_has_a_reason() -> None:
    assert not {control.row for control in BOTH} & controls.NOT_EXPRESSED.keys()
    assert all(controls.NOT_EXPRESSED.values())
