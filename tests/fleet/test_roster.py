"""What the broker passes on about each robot: who is lost, and what is taken from it, whatever it holds."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from failstop.api import verdict
from failstop.cli import style
from failstop.fleet import message, topics, view
from failstop.fleet.roster import LONGEST_PERIOD_S, MISSED_PERIODS, MOST_TEXT, Robot, Roster
from tests.support import states

NOW_S = states.NOW_S
PERIOD_S = 5.0
AFTER_S = 17.0
"""Three periods and two seconds."""


def hear(
    roster: Roster, last: str, body: dict[str, Any], at_s: float, *, retained: bool = False, off_s: float = 0.0
) -> None:
    """A message of r1, that it dates `at_s` after NOW_S, and that comes at `at_s`, monotonic; `off_s`: of its clock."""
    payload = message.Header("m", "r1", "a" * 16).message(last, body, NOW_S + (0.0 if retained else at_s) + off_s)
    roster.hear(topics.of_robot("m", "r1", last), payload, at_s, retained=retained)


def connect(roster: Roster, at_s: float, *, retained: bool = False, off_s: float = 0.0) -> None:
    body = message.connection(message.ONLINE, PERIOD_S)
    hear(roster, topics.CONNECTION, body, at_s, retained=retained, off_s=off_s)


def drive(roster: Roster, at_s: float, *, retained: bool = False, off_s: float = 0.0) -> None:
    hear(roster, topics.STATE, message.body(states.driving()), at_s, retained=retained, off_s=off_s)


def word(roster: Roster, at_s: float) -> str:
    """As the table shows it at that time."""
    return view.word(roster.robots["r1"], at_s, NOW_S + at_s)


def test_a_robot_that_falls_silent_is_lost_whatever_the_broker_calls_it() -> None:
    roster = Roster()
    connect(roster, 0.0)
    drive(roster, 1.0)
    assert word(roster, 1.0 + AFTER_S) == verdict.DRIVING
    assert word(roster, 1.1 + AFTER_S) == view.LOST
    [robot] = roster.sorted()
    assert view.why(robot, 30.0, NOW_S + 30.0) == (
        "no state for 29 s, although the broker reports it as connected; last seen DRIVING; "
        "nobody here knows what it does now"
    )
    drive(roster, 40.0)
    assert word(roster, 40.0) == verdict.DRIVING


@pytest.mark.parametrize("off_s", [-3600.0, 0.0, 3600.0])
def test_a_robot_that_was_silent_before_is_lost_by_its_clock_or_in_time(off_s: float) -> None:
    """One whose clock is ahead is known to be lost later; one that shows a sign of life is not lost by its clock."""
    roster = Roster()
    for tell in (connect, drive):
        tell(roster, 20.0, retained=True, off_s=off_s)
    assert (word(roster, 20.0) == view.LOST) is (off_s <= 0.0)
    assert word(roster, 20.1 + AFTER_S) == view.LOST
    drive(roster, 50.0, off_s=off_s)
    assert word(roster, 50.0) == verdict.DRIVING


def test_a_stored_connection_that_comes_after_a_newer_state_makes_no_robot_lost() -> None:
    roster = Roster()
    drive(roster, 0.0, retained=True)
    connect(roster, 0.0, retained=True, off_s=-3600.0)
    assert word(roster, 0.0) == verdict.DRIVING


def test_a_robot_that_never_had_a_state_is_lost_too() -> None:
    roster = Roster()
    connect(roster, 0.0)
    assert word(roster, AFTER_S) == "?"
    assert word(roster, AFTER_S + 0.1) == view.LOST


@pytest.mark.parametrize("given", [None, "5", math.nan, -1, 0, True, 1e9, 10**400, []])
def test_a_period_that_is_none_is_the_longest(given: object) -> None:
    roster = Roster()
    hear(roster, topics.CONNECTION, {"connection": "online", "state_period_s": given}, 0.0)
    assert roster.robots["r1"].silent_after_s() == MISSED_PERIODS * LONGEST_PERIOD_S + 2.0


def test_states_without_a_connection_show_that_the_list_is_blind() -> None:
    roster = Roster()
    drive(roster, 0.0)
    [robot] = roster.sorted()
    assert word(roster, 1.0) == verdict.DRIVING
    assert view.why(robot, 1.0, NOW_S + 1.0).startswith("the broker hides its connection (check the access list)")
    assert word(roster, 1000.0) == view.LOST


@pytest.mark.parametrize("volts", ["NaN", "Infinity", "-Infinity", "1e308", "1" + 400 * "0", "true", '"12"', "[]"])
def test_a_voltage_that_is_none_is_not_shown(volts: str) -> None:
    body = json.dumps(message.body(states.driving())).replace("12.0", volts)
    assert volts in body
    roster = Roster()
    roster.hear(topics.of_robot("m", "r1", topics.STATE), body[:-1].encode() + b', "t": 0}', 0.0, retained=False)
    [robot] = roster.sorted()
    assert robot.volts is None
    json.dumps(vars(robot), allow_nan=False)
    assert "battery" in style.plain(view.table([robot], 0.0, NOW_S)[0])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_robot_publishes_no_number_that_is_none(value: float) -> None:
    """JSON has no such number: another program would refuse the whole state."""
    state = states.driving(battery_v=value, body_vel=(value, 0.0, 0.1))
    body = message.body(state)
    json.dumps(body, allow_nan=False)
    assert "volts" not in body["battery"]
    assert body["velocity"] == {"vy_mps": 0.0, "wz_radps": 0.1}


@pytest.mark.parametrize("letter", ["x", "\x1b", "\u202e", "中", "\u0301"])
def test_no_cell_pushes_the_others_off_the_screen(letter: str) -> None:
    long = 50_000 * letter
    roster = Roster()
    errors = [message.warning(kind, long, "") for kind in (message.FLEET_STOP_OFF, message.DOUBLED)]
    body = {**message.body(states.driving()), "word": long, "why": long, "next": long, "errors": errors, "t": 0}
    roster.hear(f"failstop/v1/m/robot/{long}/state", json.dumps(body).encode()[:60_000], 0.0, retained=False)
    short = {**body, **dict.fromkeys(("word", "why", "next"), 500 * letter), "errors": []}
    for last, found in (("connection", message.connection("online")), ("state", short)):
        roster.hear(f"failstop/v1/m/robot/{500 * letter}/{last}", json.dumps(found).encode(), 0.0, retained=False)
    [robot] = roster.sorted()
    assert max(len(robot.id), len(robot.word), len(robot.why)) <= MOST_TEXT
    for columns in (80, None):
        for line in (*view.table([robot], 0.0, NOW_S, columns), view.counts([robot], 0.0, NOW_S)):
            shown = style.plain(line)
            assert shown.isprintable()
            assert style.cells(shown) <= view.ROBOT_COLUMNS + view.WORD_COLUMNS + view.WHY_COLUMNS + 30
    row = style.plain(view.table([robot], 0.0, NOW_S, 80)[1])
    assert style.cells(row.partition("12.0 V")[0]) <= 80 // 3 + 2 + view.WORD_COLUMNS + 4
    assert "12.0 V" in row


def test_words_that_nobody_knows_are_counted_as_other() -> None:
    robots = [Robot(f"r{number}", "online", f"word {number}", sign_s=0.0) for number in range(100)]
    assert style.plain(view.counts(robots, 0.0, NOW_S)) == "100 robots   100 other"


def test_a_robot_whose_name_two_use_is_seen_at_a_glance() -> None:
    roster = Roster()
    connect(roster, 0.0)
    warning = message.warning(message.DOUBLED, "another publisher also calls itself r1", "")
    hear(roster, topics.STATE, message.body(states.driving(), (warning,)), 0.0)
    robots = roster.sorted()
    assert "1 NAME USED TWICE" in style.plain(view.counts(robots, 0.0, NOW_S))
    assert view.why(robots[0], 0.0, NOW_S).startswith("TWO ROBOTS OF THIS NAME: another publisher also calls itself r1")
