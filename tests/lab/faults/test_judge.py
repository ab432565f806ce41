"""The judge and the campaign say when something is wrong: they are what every other word about faults rests on."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api import distance
from failstop.policy.causes import KEY
from failstop_lab.faults import report
from failstop_lab.faults.injection import Outcome, _Injection, draw, inject_one
from failstop_lab.faults.judge import verdict
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.table import FAULT_BY_NAME, TABLE
from failstop_lab.trial import judge
from tests.support.board_events import FAULT_NS, MS, STILL, TURNING, event

KILL_GATE = FAULT_BY_NAME["kill-gate"]


LIMIT_MS = KILL_GATE.limit_ms or 0.0


@pytest.mark.parametrize(
    ("times", "fault", "told"),
    [
        (((-10, True), (0.2, True), (0.5, False), (20, False)), "kill-gate", []),
        (((-10, True), (10, True)), "kill-gate", ["NO STOP"]),
        ((), "kill-gate", ["NO STOP"]),
        (((-1, False),), "kill-gate", ["NO STOP"]),  # from before the fault
        (((LIMIT_MS, False),), "kill-gate", []),
        (((LIMIT_MS + 0.1, False),), "kill-gate", ["ms, the limit is"]),
        (
            ((0.5, False), (0.6, True), (0.7, False), (0.8, True)),
            "kill-gate",
            ["2 motion frames after the stop and before any enable"],
        ),
        (((-1, False), (1, True)), "board-garbles-up", []),
        (((1, False),), "board-garbles-up", ["and nothing was to stop"]),
    ],
)
def test_the_judge_tells_a_stop_in_time_and_for_good_from_others(
    times: Sequence[tuple[float, bool]], fault: str, told: list[str]
) -> None:
    events = [event(i, ms, TURNING if moves else STILL) for i, (ms, moves) in enumerate(times)]
    found = verdict(FAULT_BY_NAME[fault], events, FAULT_NS, True)[1]
    assert len(found) == len(told)
    assert all(part in text for part, text in zip(told, found, strict=True))


def test_wheels_that_were_at_rest_prove_nothing() -> None:
    found = verdict(KILL_GATE, [event(0, 0.5, STILL)], FAULT_NS, False)[1]
    assert found == ["the wheels were not turning before the fault"]


def test_a_board_that_obeys_no_stop_is_no_error_of_the_judge() -> None:
    told = dataclasses.replace(event(0, 1.0, STILL), speeds=(0.1, 0.0, 0.0, 0.0))
    found = judge([told], FAULT_NS, True)
    assert found.stop_ns == MS
    assert found.still_ns is None
    assert judge([event(0, 1.0, TURNING)], FAULT_NS, True).motion_after == 1, "also without a stop"


def test_a_write_outside_the_motor_table() -> None:
    events = [event(0, 0.5, STILL), dataclasses.replace(event(1, 1, STILL), wild=((7, 1.0),))]
    assert verdict(KILL_GATE, events, FAULT_NS, True)[1] == ["1 writes outside the board's motor table"]


def test_what_is_counted() -> None:
    tally = report.Tally((KILL_GATE, FAULT_BY_NAME["suspended"]), seed=7)
    for events in ([event(0, 2, STILL), event(1, 3, TURNING)], [event(0, 4, STILL)], [event(0, 1, TURNING)]):
        stopped, found = verdict(KILL_GATE, events, FAULT_NS, True)
        tally.add(Outcome(KILL_GATE, 0, stopped, wrong=found, events=events))
    tally.add(Outcome(FAULT_BY_NAME["suspended"], 0, skipped="no sleep"))
    tally.add(Outcome(KILL_GATE, 0, wrong=["no service to kill"], struck=False))
    result = tally.as_dict()
    assert (result["count"], result["missed"], result["motion_after"], result["wrong"]) == (3, 1, 1, 3)
    assert result["rows"][0]["max_ms"] == 4.0
    assert result["rows"][1]["skipped"] == "no sleep"
    assert len(result["stories"]) == 3
    assert "seed 7" in tally.stories[0]
    assert "MOTION" in tally.stories[0]
    assert "not here: no sleep" in tally.table()
    assert "1 stops missed" in report.markdown(result)


def test_a_bar_that_was_missed_is_marked_on_the_page_and_named() -> None:
    bar_ms = KILL_GATE.bar_ms or 0.0
    for late, mark in ((0.0, "yes"), (0.5, "**no**")):
        tally = report.Tally((KILL_GATE,), seed=7)
        for stop_ms in (1, bar_ms + late):
            stopped, _ = verdict(KILL_GATE, [event(0, stop_ms, STILL)], FAULT_NS, True)
            tally.add(Outcome(KILL_GATE, 0, stopped))
        tally.rows["kill-gate"].times_ms[0] = tally.rows["kill-gate"].times_ms[1]
        page = report.markdown(tally.as_dict())
        (row,) = (line for line in page.splitlines() if line.startswith("| `kill-gate` "))
        assert row.endswith(f"| {bar_ms:g} | {mark} |")
        found = "0 of 1 kinds of fault, but not for kill-gate" if late else "1 of 1 kinds of fault"
        assert f"**The p99 was within its bar for {found}.**" in page
        assert tally.summary().endswith(f"; the p99 was within its bar for {found}")
        assert ("MISSED" in tally.table()) is bool(late)
        assert "(processor time that the host took away)." in page


def test_the_page_marks_every_bar_that_its_numbers_missed() -> None:
    """By the text of the page alone, with nothing of what made it."""
    page = (Path(__file__).parents[3] / "docs" / "reference" / "faults.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    timed = [row for row in rows if re.fullmatch(r"[0-9.]+", row[-4]) and row[-2][0].isdigit()]
    assert len(timed) > 100
    wrong = {
        row[0]: row[-1] for row in timed if (float(row[-4]) > float(row[-2].split()[0])) is not (row[-1] == "**no**")
    }
    assert wrong == {}
    missed = sum(row[-1] == "**no**" for row in timed)
    assert f"**The p99 was within its bar for {len(timed) - missed} of {len(timed)} kinds of fault" in page


def test_the_stopping_distance_reckons_with_what_was_measured() -> None:
    found = report.last_campaign(Path(__file__).parents[3])["rows"]
    deaths = [row["p99_ms"] for row in found if re.match("(kill|crash)-[a-z_]+$", row["name"])]
    assert len(deaths) == 10
    assert max(deaths) <= 1000 * distance.DEATH_S
    for name, deadline_ms in (("hang-gate+stopper", 60), ("spin-port_owner", 100), ("hang-telemetry", 500)):
        (late_ms,) = (row["p99_ms"] - deadline_ms for row in found if row["name"] == name)
        assert late_ms <= 1000 * distance.SLACK_S


def test_a_seed_is_a_campaign() -> None:
    drawn = [draw(TABLE, index, 5) for index in range(200)]
    assert drawn == [draw(TABLE, index, 5) for index in range(200)]
    assert drawn != [draw(TABLE, index, 6) for index in range(200)]
    assert len({fault.name for fault in drawn}) > 50


@pytest.mark.slow
def test_a_row_that_does_not_hold_is_told_and_its_scene_is_left_nowhere(scene: Scene) -> None:
    """Rows that are not true: the campaign must say so, with what the board and the service said."""
    garbled = "NO STOP", "the wheels to stand", "blocked: disabled"
    asked = "nothing was to stop", "latched: stop request: nobody says so", "the wheels to turn again"
    lies: tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...] = (
        ("kill-gate", {"latched": ((KEY, 9),), "logged": "never said"}, ("a latch: key 9", "to say 'never said'")),
        ("board-garbles-up", {"bar_ms": 5.0, "cleared": "enable"}, garbled),
        ("stop-request", {"latched": (), "cleared": "by itself", "bar_ms": None}, asked),
    )
    before = scene.service.pids()
    for index, (name, changes, told) in enumerate(lies):
        lie = dataclasses.replace(FAULT_BY_NAME[name], **changes)
        outcome = inject_one(scene, lie, index, "lies", seen_s=0.3)
        for each in told:
            assert any(each in text for text in outcome.wrong), (each, outcome.wrong)
            assert each in outcome.story("lies")
    assert not set(before.values()) & set(scene.service.pids().values()), "a failed scene is made anew"
    assert not any(Path(f"/proc/{pid}").exists() for pid in before.values()), "and left nowhere"
    assert not inject_one(scene, KILL_GATE, 0, "and on").wrong, "the next scene is whole"


def alone(**scene: object) -> _Injection:
    """An injection of nothing into a scene made of these parts."""
    made = _Injection.__new__(_Injection)
    made.scene = SimpleNamespace(restart=lambda: None, **scene)  # type: ignore[assignment]
    made.fault, made.outcome = FAULT_BY_NAME["service-stopped"], Outcome(FAULT_BY_NAME["service-stopped"], 0)
    return made


def test_enabled_while_latched_is_told() -> None:
    made = alone(driver=SimpleNamespace(robot=SimpleNamespace(enable=lambda: None)))
    made._check_latch()
    assert made.outcome.wrong == ["enabled while latched"]


def test_a_service_that_ends_badly_is_told() -> None:
    made = alone(service=SimpleNamespace(process=SimpleNamespace(wait=lambda _: 3)))
    made._end_run()
    assert made.outcome.wrong == ["the service ended with exit code 3"]
