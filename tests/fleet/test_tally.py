"""Confirmations of a stop: who has confirmed, who is missing, and how that is told."""

from __future__ import annotations

from failstop.cli import style
from failstop.fleet import levels, report
from failstop.fleet.levels import StopAnswer
from failstop.fleet.tally import Tally

STOP_ID = "0" * 32


def say(tally: Tally, robot: str, *told: str, why: str = "", after_s: float = 0.1) -> None:
    for level in told:
        tally.answer(StopAnswer(STOP_ID, robot, {level: 0.0}, why), after_s)


def connected(*robots: str, expected: frozenset[str] | None = None) -> Tally:
    tally = Tally(expected)
    for robot in robots:
        tally.connection(robot, "ONLINE")
    return tally


def text(tally: Tally) -> str:
    return "\n".join(style.plain(line) for line in report.lines(tally))


def test_nobody_is_known() -> None:
    tally = Tally(None)
    assert not tally.all_reached(levels.WRITTEN)
    assert not tally.all_confirmed()
    assert "NO ROBOT is known" in text(tally)


def test_all_of_them() -> None:
    tally = connected("a", "b")
    for robot in "ab":
        say(tally, robot, levels.ASKED, *levels.PROOFS)
    assert tally.all_confirmed()
    assert tally.missing() == []
    assert text(tally).startswith("2 of 2 robots have confirmed the stop\n")
    assert "NOT" not in text(tally)


def test_everybody_who_is_missing_is_named_with_what_is_known() -> None:
    tally = connected("a", "b", "c", "d", "e")
    tally.connection("f", "CONNECTIONBROKEN")
    tally.connection("g", "OFFLINE")
    say(tally, "a", levels.ASKED, *levels.PROOFS)
    say(tally, "b", levels.ASKED, levels.WRITTEN)
    say(tally, "c", levels.REFUSED, why="dated old by 60 s")
    say(tally, "d", levels.FAILED, why="no service")
    say(tally, "e", levels.ASKED)
    assert {row.robot: row.why for row in tally.missing()} == {
        "b": "written, but its board has not acknowledged it",
        "c": "refused: dated old by 60 s",
        "d": "failed: no service",
        "e": "asked, but not written as far as it knows",
        "f": "no answer: its connection is broken",
        "g": "no answer: its publisher was ended",
    }
    assert text(tally).startswith("1 of 7 robots have confirmed the stop\n")
    found = report.as_dict(tally)
    assert (found["confirmed"], found["robots"], len(found["missing"])) == (1, 7, 6)
    assert found["written"]["robots"] == ["a", "b"]


def test_a_list_counts_those_whom_the_broker_never_saw() -> None:
    tally = connected("a", "stranger", expected=frozenset({"a", "b"}))
    say(tally, "a", *levels.PROOFS)
    assert [row.robot for row in tally.missing()] == ["b"]
    say(tally, "b", *levels.PROOFS)
    assert tally.all_reached(levels.ACKNOWLEDGED)


def test_who_answers_counts_though_nobody_knew_of_it() -> None:
    tally = connected("a")
    say(tally, "a", *levels.PROOFS)
    say(tally, "b", levels.ASKED)
    assert [row.robot for row in tally.missing()] == ["b"]


def test_a_robot_that_was_taken_off_the_broker_is_not_missed() -> None:
    tally = connected("a", "b")
    tally.connection("b", "")
    say(tally, "a", *levels.PROOFS)
    assert tally.missing() == []


def test_a_failure_that_was_mended_is_a_confirmation() -> None:
    tally = connected("a")
    say(tally, "a", levels.FAILED, why="no port")
    say(tally, "a", levels.WRITTEN, levels.ACKNOWLEDGED)
    assert tally.missing() == []


def test_the_first_time_of_a_level_counts() -> None:
    tally = connected("a")
    say(tally, "a", levels.WRITTEN, after_s=0.2)
    say(tally, "a", levels.WRITTEN, after_s=0.9)
    assert tally.times_s(levels.WRITTEN) == [0.2]


def test_a_robot_confirms_by_what_its_board_can_give() -> None:
    tally = connected("a", "b", "c")
    for robot, confirms in (("a", levels.ACKNOWLEDGED), ("b", levels.OBSERVED), ("c", levels.WRITTEN)):
        tally.answer(StopAnswer(STOP_ID, robot, {levels.WRITTEN: 0.0}, "", confirms), 0.1)
    assert {row.robot: row.why for row in tally.missing()} == {
        "a": "written, but its board has not acknowledged it",
        "b": "written, but its IMU has not observed that the wheels stand",
    }
    assert not tally.all_confirmed()
    tally.answer(StopAnswer(STOP_ID, "a", {levels.ACKNOWLEDGED: 0.0}), 0.2)
    tally.answer(StopAnswer(STOP_ID, "b", {levels.OBSERVED: 0.0}, "", levels.OBSERVED), 0.2)
    assert tally.all_confirmed()
    assert text(tally).startswith("3 of 3 robots have confirmed the stop\n")
    assert "c confirms as written: its board acknowledges nothing" in text(tally)
    by = {"a": levels.ACKNOWLEDGED, "b": levels.OBSERVED, "c": levels.WRITTEN}
    assert report.as_dict(tally)["confirmed_by"] == by
