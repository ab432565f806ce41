"""What the screens say of the wheels: by the table, on every screen, against nothing that is seen."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
from typing import Any

import pytest

from failstop.api import verdict, wheels
from failstop.api.snapshot import Device, Imu, State, Turning
from failstop.api.wheels import TABLE, Commanded, Seen
from failstop.api.why import explain
from failstop.cli import style
from failstop.cli.commands.status import Live
from failstop.cli.screen import summary
from failstop.fleet import message, metrics
from failstop.policy import causes
from failstop.ros2 import diagnostics, report
from failstop.web import view
from tests.support import states
from tests.support.states import NOW_S, driving, latched, state, stop

DEAF = Device("/dev/ttyACM0", "open", "deaf")
GONE = Device("/dev/ttyACM0", "lost", "alive")
REPORTS_NOTHING = Device("/dev/ttyACM0", "open", "unasked", imu=False)
ZERO: dict[str, Any] = {"body_vel": (0.0, 0.0, 0.0), "wheels_radps": (0.0, 0.0, 0.0, 0.0)}
SEEN_STILL = stop(observed_s=0.3)
TOLD_ZERO = {
    "disabled": state(),
    "enabled and idle": driving(**ZERO),
    "enabled, nobody commands": driving(blocked="cmd timeout", **ZERO),
    "latched": latched(),
    "latched, and once seen still": latched(last_stop=SEEN_STILL),
    "after a reset, once seen still": state(last_stop=SEEN_STILL),
    "after the port came back": state(last_stop=stop(causes.DEVICE_LOST(), written_s=None)),
    "while the gate is down": latched(causes.DIED("gate"), waiting_for="gate"),
    "latched as unstill": latched(causes.UNSTILL()),
}
"""The states in which wheels are told zero and the port is open."""


def screens(found: State) -> dict[str, str]:
    """Every screen, as text."""
    live = Live("failstop").lines(found, 1.0, NOW_S, 400, 60)
    shown = view.view(found, [], NOW_S)
    return {
        "status": "\n".join(map(style.plain, summary.lines(found, NOW_S, 400))),
        "watch": "\n".join(map(style.plain, live)),
        "why": str(explain(found, [], NOW_S)),
        "page": f"{shown['word']}. {shown['why']} {view.live(found, 0.001)[6]}",
        "fleet": json.dumps(message.body(found)),
        "metrics": "\n".join(f"{row.name} {value:g}" for row, told in metrics.collect(found) for _, value in told),
        "diagnostics": json.dumps(diagnostics.statuses("node", found, "", [], [])),
        "ros state": json.dumps(report.as_json(found, [], [])),
        "ros status": json.dumps(report.status(found)),
        "json": json.dumps(found.as_dict(), default=str),
    }


TELLS = {
    "status": "the wheels turn although they are told to stop",
    "watch": "the wheels turn although they are told to stop",
    "why": "THE WHEELS TURN (use the POWER SWITCH",
    "page": "WHEELS TURN. The wheels turn although they are told to stop.",
    "fleet": '"wheels_may_turn"',
    "metrics": "failstop_wheels_unexpected 1",
    "diagnostics": "TURNING: the wheels turn although they are told to stop",
    "ros state": '"word": "TURNING", "does": "turning", "by": "wheels", "unexpected": true',
    "ros status": '"wheels_unexpected": true',
    "json": '"unexpected": true',
}


def test_the_table_has_every_pair() -> None:
    assert TABLE.keys() == set(itertools.product(Commanded, Seen))
    assert wheels.SEEN.keys() == set(Seen)
    assert all(row.text or row.word in (wheels.STOPPED, wheels.DRIVING, wheels.MAY_TURN) for row in TABLE.values())
    assert {key for key, row in TABLE.items() if row.word == wheels.STOPPED} == {(Commanded.ZERO, Seen.STILL)}


@pytest.mark.parametrize("name", TOLD_ZERO)
def test_wheels_that_turn_although_told_zero_are_on_every_screen(name: str) -> None:
    found = dataclasses.replace(TOLD_ZERO[name], turning=states.TURNS_ON)
    for screen, text in screens(found).items():
        assert TELLS[screen] in text, screen
        assert not re.search(r"\b(STOPPED|STANDING)\b", text), (screen, text)


@pytest.mark.parametrize("turning", [states.TURNS, states.MOVES, states.MOVES_ON, states.TURNED, states.UNREAD])
@pytest.mark.parametrize("name", TOLD_ZERO)
def test_no_screen_says_stopped_of_wheels_that_are_not_seen_still(name: str, turning: Turning) -> None:
    for screen, text in screens(dataclasses.replace(TOLD_ZERO[name], turning=turning)).items():
        assert not re.search(r"\b(STOPPED|STANDING)\b", text), (screen, text)


@pytest.mark.parametrize(
    ("found", "word", "large", "alarm"),
    [
        (state(turning=states.TURNS), "STOPPING", "STOPPING", False),
        (state(turning=states.MOVES), "STOPPING", "STOPPING", False),
        (driving(turning=states.TURNS, **ZERO), "STOPPING", "CAN MOVE", False),
        (driving(turning=states.TURNS_ON, **ZERO), "TURNING", "WHEELS TURN", True),
        (driving(turning=states.MOVES_ON, **ZERO), "MOVED", "ROBOT MOVES", True),
        (latched(turning=states.TURNED), "MAY TURN", "WHEELS MAY TURN", True),
        (state(turning=states.UNREAD), "TOLD TO STOP", "TOLD TO STOP", False),
        (state(turning=states.UNSEEN, device=REPORTS_NOTHING), "TOLD TO STOP", "TOLD TO STOP", False),
        (latched(last_stop=stop(acknowledged_s=None, observed_s=None)), "STOPPED", "STOP WRITTEN", False),
        (driving(turning=states.TURNS), "DRIVING", "MOVING", False),
        (driving(turning=states.UNREAD), "DRIVING", "MOVING", False),
        (state(device=GONE, turning=states.TURNS), "TURNING", "WHEELS TURN", True),
        (state(device=DEAF, turning=states.MOVES_ON), "MOVED", "ROBOT MOVES", True),
        (state(device=DEAF), "MAY TURN", "WHEELS MAY TURN", True),
        (latched(causes.UNSTILL()), "STOPPED", "STOPPED", False),
    ],
)
def test_the_words(found: State, word: str, large: str, alarm: bool) -> None:
    assert (verdict.word(found), verdict.large_word(found)) == (word, large)
    assert bool(verdict.doubt(found)) == alarm


def test_a_board_that_does_not_answer_and_reports_turning_wheels_is_told_as_both() -> None:
    told = verdict.doubt(state(device=DEAF, turning=states.TURNS))
    assert told == "the wheels turn, and the board does not hear, so a stop may not reach the wheels"


@pytest.mark.parametrize(
    ("turning", "text"),
    [
        (states.STILL, "the IMU feels no movement (0.0 s ago)"),
        (dataclasses.replace(states.STILL, by="wheels"), "the wheels are still (by the board's reports, 0.0 s ago)"),
        (states.MOVES, "the robot moves, or is being moved (by the IMU, 0.0 s ago)"),
        (states.UNREAD, "not known (last read 3.2 s ago)"),
        (
            states.TURNED,
            "not known; at the last reading the wheels were turning: front left +0.80, rear left +0.80, front "
            "right +0.80, "
            "rear right +0.80 turns/s (last read 3.2 s ago)",
        ),
        (states.UNSEEN, "not known: nothing reports what the wheels do"),
    ],
)
def test_what_is_seen_has_its_source_and_its_age(turning: Turning, text: str) -> None:
    found = state(turning=turning)
    assert wheels.now(found) == text
    for screen in ("status", "watch", "why", "page", "fleet"):
        assert text in screens(found)[screen], screen


def test_an_imu_that_says_nothing_yet_is_named() -> None:
    sample = Imu(1, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0))
    found = state(turning=states.UNSEEN, imu=sample)
    assert wheels.now(found) == "not known (the IMU can't tell yet)"
    assert verdict.word(found) == "TOLD TO STOP"


def test_a_reading_is_told_with_its_age_to_programs() -> None:
    found = state(turning=states.TURNED)
    assert report.wheels(found)["age_ms"] == 3200.0
    assert report.status(found)["wheels_age_s"] == 3.2
    samples = {family.name: told for family, told in metrics.collect(found)}
    assert samples["failstop_wheels_reading_age_seconds"] == [((), 3.2)]
    assert "failstop_wheel_speed_radians_per_second" not in samples, "of speeds that are old nobody knows"


def test_numbers_and_ages_are_no_news_to_a_fleet_or_to_diagnostics() -> None:
    early, late = (state(turning=dataclasses.replace(states.TURNS_ON, age_s=age_s)) for age_s in (0.01, 0.3))
    assert message.steady(message.body(early)) == message.steady(message.body(late))
    rows = [diagnostics.statuses("node", found, "", [], []) for found in (early, late)]
    assert not diagnostics.changed(*rows)


def test_a_push_is_not_called_driving_by_programs_that_ask_whether_it_is_commanded() -> None:
    pushed = state(turning=states.TURNS_ON)
    assert not pushed.moving
    assert message.body(pushed)["moves"], "the fleet asks whether the robot moves"
