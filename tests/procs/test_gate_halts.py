"""Notes for people when a driver leaves off: the wheels stop without a latch."""

from __future__ import annotations

import pytest

from failstop.policy.settings import PAD_SOURCE
from failstop.procs.gate.sources import PAD_SESSION
from tests.support.why import why

from .gate_bench import MS, REST, TICK, Gate

VELOCITY = (0.2, 0.0, 0.0)


def kinds(gate: Gate) -> list[str]:
    """Kinds of the notes since the last look."""
    found = [note.kind for note in gate.core.notes]
    gate.core.notes.clear()
    return found


def test_a_driver_that_falls_silent_is_told_of_once_with_its_name(driving: Gate) -> None:
    driving.drive(VELOCITY, 3)
    assert kinds(driving) == []
    driving.step(281 * MS)
    (note,) = driving.core.notes
    assert (note.kind, note.fields["who"], note.fields["source"]) == ("driver_silent", "client 1", "cmd_vel")
    assert note.fields["silent_ms"] == 301
    assert "client 1 fell silent" in note.text
    kinds(driving)
    for _ in range(100):
        driving.step()
    assert kinds(driving) == []


@pytest.mark.parametrize("kind", ["driver_gone", "driver_silent"])
def test_the_news_of_a_driver_hides_no_other(driving: Gate, kind: str) -> None:
    """A program commands in the same turn as a source that no setting names. A driver that has gone is not told of as
    silent too."""
    driving.drive(VELOCITY, 3)
    driving.take(VELOCITY, 2, source="navv")
    if kind == "driver_gone":
        driving.gone(1)
    driving.step(301 * MS)
    assert kinds(driving) == ["ignored", kind]


def by_hand(gate: Gate, source: str = "cmd_vel", session: int = 1) -> None:
    """A person's command."""
    assert gate.take(VELOCITY, session, manual=True, source=source) == ""
    gate.step()


def test_a_person_s_command_that_runs_out_is_let_go_but_for_the_gamepad_s(driving: Gate) -> None:
    """The gamepad says where its sticks are for as long as it can be heard."""
    by_hand(driving)
    driving.step(301 * MS)
    (note,) = driving.core.notes
    assert (note.kind, note.fields) == ("driver_ended", {"who": "client 1", "source": "cmd_vel"})
    assert note.text == "client 1 let go: last command 321 ms ago, the wheels are stopped"
    kinds(driving)
    by_hand(driving, PAD_SOURCE, PAD_SESSION)
    driving.step(301 * MS)
    assert kinds(driving) == ["driver_silent"]


def test_ordinary_ends_without_end_do_not_hide_a_silent_driver(driving: Gate) -> None:
    for _ in range(50):
        by_hand(driving)
        driving.step(301 * MS)
    assert kinds(driving).count("driver_ended") < 20
    driving.drive(VELOCITY, 2)
    driving.step(301 * MS)
    assert kinds(driving) == ["driver_silent"]


def test_a_driver_that_stopped_the_wheels_before_is_not_told_of(driving: Gate) -> None:
    driving.drive(VELOCITY, 3)
    driving.drive(REST, 30)
    driving.step(301 * MS)
    driving.gone(1, parted=True)
    assert kinds(driving) == []


def test_a_latched_or_disabled_robot_has_no_silent_driver(driving: Gate) -> None:
    driving.drive(VELOCITY, 3)
    driving.core.stop(why("key1"), 1)
    driving.step(301 * MS)
    assert kinds(driving) == []


def test_a_driver_that_falls_silent_without_end_is_told_of_now_and_then(driving: Gate) -> None:
    count = 0
    for _ in range(200):
        driving.drive(VELOCITY, 2)
        driving.step(301 * MS)
        count += len(kinds(driving))
    elapsed_s = 200 * (2 * TICK + 301 * MS) / 1e9
    assert 5 <= count <= 5 + elapsed_s / 10 + 1
