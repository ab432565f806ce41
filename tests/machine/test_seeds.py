"""Seeds: a run that is drawn is the same again, and what fails is told by the events that it needs."""

from __future__ import annotations

import pytest

from failstop.lab.simulate import controls, seeds
from failstop.lab.simulate.controls import CONTROLS
from failstop.lab.simulate.odd import HANG_UP, Event
from failstop.lab.simulate.seeds import Nursery, Seeded
from failstop.lab.simulate.tape import Tape

pytestmark = pytest.mark.slow
OWN_STOP = next(each for each in CONTROLS if each.row == "own stop does not refuse motion")


def test_a_draw_that_is_taken_out_changes_no_other() -> None:
    labels = [f"event {number}" for number in range(20)]
    whole, without = Tape(7), Tape(7, ["event 3"])
    drawn = {label: (whole.draw(label, 1000, 0.9), without.draw(label, 1000, 0.9)) for label in labels}
    assert drawn["event 3"][0]
    assert drawn.pop("event 3")[1] == 0
    assert all(one == other for one, other in drawn.values())
    assert len({one for one, _ in drawn.values()}) > 10


def test_a_seed_is_the_same_run_each_time() -> None:
    first, second = ([nursery.run(seed) for seed in range(3)] for nursery in (Nursery(["gate_dies"]), Nursery()))
    again = [Nursery(["gate_dies"]).run(seed) for seed in range(3)]
    assert first == again
    assert any(run.events for run in first)
    assert [run.scenario for run in second] != [run.scenario for run in first]


def test_events_that_are_given_come_where_they_came_before() -> None:
    nursery = Nursery(["gate_dies"])
    for seed in range(3):
        run = nursery.run(seed)
        assert nursery.run(seed, run.events).events == run.events


def test_a_failure_keeps_only_the_events_that_it_needs() -> None:
    """The stop of the port owner's own is what the stop request is answered by."""
    nursery = Nursery([OWN_STOP.scenario], OWN_STOP.patches)
    failed = next(run for seed in range(40) if (run := nursery.run(seed)).violations)
    shrunk = nursery.shrunk(failed)
    assert shrunk.violations
    assert len(shrunk.events) <= len(failed.events)
    for event in shrunk.events:
        assert not nursery.run(failed.seed, [each for each in shrunk.events if each != event]).violations


def test_a_campaign_ends_with_its_time_and_counts_its_faults() -> None:
    found = seeds.seeds(0, 1, 1.0, names=["gate_dies"])
    assert found.took_s >= 1.0
    assert found.runs == 0 or found.events >= found.runs
    other = seeds.Seeds()
    other.add(
        Seeded(3, "gate_dies", [Event(HANG_UP, "stopper", 0, "late")], ["the wheels turn"], again="failstop simulate")
    )
    found.merge(other)
    assert found.wrong[-1].seed == 3
    assert "again: failstop simulate --seed 3" in found.wrong[-1].text()


def test_what_no_change_of_the_source_stands_for_has_a_reason() -> None:
    rows = {control.row for control in CONTROLS}
    assert not rows & controls.NOT_EXPRESSED.keys()
    assert all(controls.NOT_EXPRESSED.values())
