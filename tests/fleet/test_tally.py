"""Confirmations of a stop: who has confirmed, who is missing, and how that is told."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.cli import style
from failstop.fleet import levels, report
from failstop.fleet.levels import StopAnswer
from failstop.fleet.tally import DOUBLED, OLDER, Tally

STOP_ID = "0" * 32
FIRST, SECOND = "a" * 16, "b" * 16
"""Numbers of publishers."""


def answer(robot: str, *told: str, **changed: Any) -> StopAnswer:
    """Of a publisher that has been connected for long."""
    given = {"publisher": FIRST, "connected_s": 100.0, **changed}
    return StopAnswer(STOP_ID, robot, dict.fromkeys(told, 0.0), **given)


def say(tally: Tally, robot: str, *told: str, after_s: float = 0.1, **changed: Any) -> None:
    tally.answer(answer(robot, *told, **changed), after_s)


def connected(*robots: str, expected: frozenset[str] | None = None) -> Tally:
    tally = Tally(expected)
    for robot in robots:
        tally.connection(robot, "online", FIRST)
    return tally


def text(tally: Tally) -> str:
    return "\n".join(style.plain(line) for line in report.lines(tally))


def test_nobody_is_known() -> None:
    tally = Tally(None)
    assert tally.reached(levels.WRITTEN) == []
    assert not tally.all_confirmed()
    assert "This broker knows NO ROBOT" in text(tally)


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
    tally.connection("f", "lost", FIRST)
    tally.connection("g", "offline", FIRST)
    say(tally, "a", levels.ASKED, *levels.PROOFS)
    say(tally, "b", levels.ASKED, levels.WRITTEN)
    say(tally, "c", levels.REFUSED, why="dated old by 60 s")
    say(tally, "d", levels.FAILED, why="no service")
    say(tally, "e", levels.ASKED)
    assert {row.robot: row.why for row in tally.missing()} == {
        "b": "written, but its board has not acknowledged it",
        "c": "refused: dated old by 60 s",
        "d": "failed: no service",
        "e": "asked, but as far as it knows not written",
        "f": "no answer: its connection is broken",
        "g": "no answer: its publisher was ended",
    }
    assert text(tally).startswith("1 of 7 robots have confirmed the stop\n")
    found = report.as_dict(tally)
    assert (found["confirmed"], found["robots"], len(found["missing"])) == (1, 7, 6)
    assert found["written"]["robots"] == ["a", "b"]


def test_a_list_adds_to_those_whom_the_broker_knows() -> None:
    """One that is old hides nobody."""
    tally = connected("a", "stranger", expected=frozenset({"a", "b"}))
    say(tally, "a", *levels.PROOFS)
    whys = {row.robot: row.why for row in tally.missing()}
    assert whys["b"] == "no answer, and the broker does not remember it"
    assert whys["stranger"].startswith("no answer, though the broker calls it connected")
    for robot in ("b", "stranger"):
        assert not tally.all_confirmed()
        say(tally, robot, *levels.PROOFS)
    assert tally.reached(levels.ACKNOWLEDGED) == tally.robots()
    assert tally.all_confirmed()


def test_who_answers_counts_though_nobody_knew_of_it() -> None:
    tally = connected("a")
    say(tally, "a", *levels.PROOFS)
    say(tally, "b", levels.ASKED)
    assert [row.robot for row in tally.missing()] == ["b"]


def test_a_robot_that_is_taken_off_the_broker_during_the_stop_is_missed() -> None:
    tally = connected("a", "b")
    tally.connection("b", "")
    tally.connection("never there", "")
    say(tally, "a", *levels.PROOFS)
    [row] = tally.missing()
    assert (row.robot, row.why) == ("b", "no answer: its connection was removed from the broker during this stop")


@pytest.mark.parametrize("first", ["connection", "answer"])
@pytest.mark.parametrize("second", ["connection", "answer", "says so"])
def test_a_robot_whose_name_two_use_is_never_confirmed(first: str, second: str) -> None:
    """Whichever way the second one shows, and however late."""
    tally = connected("a", "b") if first == "connection" else connected("b")
    for robot in "ab":
        say(tally, robot, *levels.PROOFS)
    assert first == "answer" or tally.all_confirmed()
    if second == "connection":
        tally.connection("a", "online", SECOND)
    else:
        number = FIRST if second == "says so" else SECOND
        tally.answer(answer("a", levels.OBSERVED, publisher=number, doubled=second == "says so"), 0.3)
    assert not tally.all_confirmed()
    [row] = tally.missing()
    assert (row.robot, row.why) == ("a", DOUBLED)
    assert (tally.reached(levels.WRITTEN), len(tally.times_s(levels.OBSERVED))) == (["b"], 1)
    assert text(tally).startswith("1 of 2 robots have confirmed the stop\n")
    say(tally, "a", *levels.PROOFS)
    assert not tally.all_confirmed(), "whatever it answers afterwards"


@pytest.mark.parametrize("word", ["offline", "lost"])
def test_a_robot_that_was_lost_is_not_confirmed_by_another_one_of_its_name(word: str) -> None:
    tally = Tally(None)
    tally.connection("a", word, FIRST)
    tally.answer(answer("a", levels.ACKNOWLEDGED, publisher=SECOND), 0.1)
    assert [row.why for row in tally.missing()] == [DOUBLED]
    tally.connection("a", "online", SECOND)
    assert tally.all_confirmed(), "it was the same robot, which is back"


def test_a_robot_that_was_lost_and_confirmed_before_stays_confirmed() -> None:
    tally = connected("a")
    say(tally, "a", *levels.PROOFS)
    tally.connection("a", "lost", FIRST)
    assert tally.all_confirmed()


def test_a_publisher_without_a_number_is_refused_by_name() -> None:
    """Two of that kind would be counted as one."""
    tally = Tally(None)
    tally.connection("a", "online")
    tally.answer(answer("a", levels.ACKNOWLEDGED, publisher=""), 0.1)
    assert [(row.robot, row.why) for row in tally.missing()] == [("a", OLDER)]
    tally.answer(answer("a", levels.ACKNOWLEDGED, publisher=SECOND), 0.1)
    assert [row.why for row in tally.missing()] == [DOUBLED]


def test_who_answers_without_a_connection_was_hidden() -> None:
    tally = connected("a")
    say(tally, "a", *levels.PROOFS)
    assert tally.hidden() == []
    say(tally, "b", *levels.PROOFS)
    assert tally.hidden() == ["b"]


def test_a_count_that_is_in_doubt_does_not_read_like_all_of_them() -> None:
    tally = connected("a")
    say(tally, "a", *levels.PROOFS)
    shown = "\n".join(style.plain(line) for line in report.lines(tally, ["the broker may hide others"]))
    assert shown.startswith("1 of at least 1 robots have confirmed the stop\n")
    assert "1 of 1" not in shown
    assert "There may be MORE ROBOTS" in shown
    found = report.as_dict(tally, ["the broker may hide others"])
    assert (found["complete"], found["doubts"]) == (False, ["the broker may hide others"])
    assert report.as_dict(tally)["complete"] is True


def test_the_connections_of_robots_say_how_long_the_broker_has_run() -> None:
    tally = Tally(None)
    assert tally.oldest_s() is None
    for robot, after_s, connected_s in (("a", 1.0, 0.5), ("b", 2.0, 30.0), ("c", 3.0, 0.0)):
        tally.answer(answer(robot, levels.ACKNOWLEDGED, connected_s=connected_s), after_s)
    assert tally.oldest_s() == -28.0
    assert (tally.young(2.0), tally.young(3.0), tally.young(6.0)) == (["a", "c"], ["c"], [])
    tally.reconnected()
    assert (tally.oldest_s(), tally.young(3.0)) == (None, [])


def test_progress_is_one_line_with_names() -> None:
    tally = connected(*(f"r{number}" for number in range(8)))
    say(tally, "r0", *levels.PROOFS)
    found = report.progress(tally, "", 3.2)
    waits = "waiting for r1, r2, r3, r4, r5 and 2 more"
    assert found == f"1 of 8 robots have confirmed; {waits} (3 s; Ctrl-C shows the report so far)"
    assert report.progress(tally, "no broker at here", 0.0).startswith("no broker at here: trying again")
    alone = connected("a")
    say(alone, "a", *levels.PROOFS)
    assert "listening for others" in report.progress(alone, "", 1.0)


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


def test_a_robot_that_contradicts_what_it_confirmed_is_missing_until_it_takes_that_back() -> None:
    tally = connected("a", "b")
    both = (levels.ASKED, levels.WRITTEN, levels.ACKNOWLEDGED)
    say(tally, "a", *both)
    say(tally, "b", *both)
    assert tally.all_confirmed()
    say(tally, "a", *both, why="the wheels turn")
    assert not tally.all_confirmed()
    assert [(row.robot, row.why) for row in tally.missing()] == [("a", "acknowledged, but: the wheels turn")]
    assert text(tally).startswith("1 of 2 robots have confirmed the stop\n")
    assert report.as_dict(tally)["complete"] is False
    say(tally, "a", *both)
    assert tally.all_confirmed()


def test_a_level_that_the_newest_answer_no_longer_has_does_not_count() -> None:
    """The robot's service was restarted, and its next run has not proved anything yet."""
    tally = connected("a")
    say(tally, "a", levels.ASKED, *levels.PROOFS)
    say(tally, "a", levels.ASKED, after_s=2.0)
    assert not tally.all_confirmed()
    assert tally.reached(levels.OBSERVED) == []
    assert [row.why for row in tally.missing()] == ["asked, but as far as it knows not written"]
    say(tally, "a", levels.ASKED, *levels.PROOFS, after_s=3.0)
    assert tally.all_confirmed()
    assert tally.times_s(levels.WRITTEN) == [3.0]


def test_a_robot_that_could_observe_its_wheels_and_has_not_is_named() -> None:
    tally = connected("a", "b", "c")
    for robot, levels_too, observes in (("a", (levels.OBSERVED,), True), ("b", (), True), ("c", (), False)):
        say(tally, robot, levels.WRITTEN, levels.ACKNOWLEDGED, *levels_too, observes=observes)
    assert tally.all_confirmed()
    assert tally.unobserved() == ["b"]
    assert "  b has not observed that its wheels are still\n" in text(tally)
    assert report.as_dict(tally)["unobserved"] == ["b"]


def test_a_listed_robot_that_the_broker_never_named_may_be_hidden() -> None:
    tally = connected("a", expected=frozenset({"a", "b"}))
    assert tally.unnamed() == ["b"]
    tally.connection("b", "lost", FIRST)
    assert tally.unnamed() == []


def test_a_robot_confirms_by_what_its_board_can_give() -> None:
    tally = connected("a", "b", "c")
    for robot, confirms in (("a", levels.ACKNOWLEDGED), ("b", levels.OBSERVED), ("c", levels.WRITTEN)):
        tally.answer(answer(robot, levels.WRITTEN, confirms=confirms), 0.1)
    assert {row.robot: row.why for row in tally.missing()} == {
        "a": "written, but its board has not acknowledged it",
        "b": "written, but it has not observed that its wheels have stopped",
    }
    assert not tally.all_confirmed()
    tally.answer(answer("a", levels.ACKNOWLEDGED), 0.2)
    tally.answer(answer("b", levels.OBSERVED, confirms=levels.OBSERVED), 0.2)
    assert tally.all_confirmed()
    assert text(tally).startswith("3 of 3 robots have confirmed the stop\n")
    assert "c confirms as written, because its board can't answer" in text(tally)
    by = {"a": levels.ACKNOWLEDGED, "b": levels.OBSERVED, "c": levels.WRITTEN}
    assert report.as_dict(tally)["confirmed_by"] == by
