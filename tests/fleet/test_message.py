"""What a robot publishes on the broker: its connection, its state and its last stop."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from failstop.api.errors import FailstopError, NoService
from failstop.api.snapshot import OLD_S, Ages, Device, Starved
from failstop.fleet import message, topics
from failstop.fleet.roster import Roster
from failstop.fleet.settings import BY_KEY, FleetSettings
from failstop.policy import causes
from failstop.policy.setting import SettingError
from failstop.version import VERSION
from tests.support import states


def test_a_header_counts_by_topic() -> None:
    header = message.Header("hall", "r1", "a" * 16)
    numbers = [json.loads(header.message(last, {}, 0.5))["number"] for last in ("a", "a", "b", "a")]
    assert numbers == [0, 1, 0, 2]
    found = json.loads(header.message("b", {}, 0.5))
    assert found == {"number": 1, "t": 0.5, "fleet": "hall", "robot": "r1", "failstop": VERSION,
                     "publisher": "a" * 16}  # fmt: skip
    assert header.topic("state") == "failstop/v1/hall/robot/r1/state"
    assert topics.robot_of(header.topic("state")) == ("r1", "state")


@pytest.mark.parametrize("given", [None, True, "yesterday", -1, math.nan, math.inf, 10**400, []])
def test_a_date_that_is_none(given: object) -> None:
    assert message.date(given) is None
    assert message.date(1.5) == 1.5


def test_a_stop_that_is_latched_says_why_and_what_to_do() -> None:
    found = message.body(states.latched(causes.DIED("gate")))
    assert (found["word"], found["why"], found["latched"]) == ("STOPPED", "gate died", True)
    assert "`failstop reset`" in found["next"]
    (error,) = found["errors"]
    assert (error["kind"], error["level"], error["text"]) == ("stop_latched", "fatal", "gate died")
    assert error["fields"]["cause"] == "died"
    assert error["next"] == found["next"]


def test_driving() -> None:
    found = message.body(states.driving())
    assert (found["word"], found["why"]) == ("DRIVING", "0.20 m/s forward")
    assert (found["moves"], found["enabled"], found["latched"], found["errors"]) == (True, True, False, [])
    assert found["velocity"] == {"vx_mps": 0.2, "vy_mps": 0.0, "wz_radps": 0.0}


def test_disabled() -> None:
    found = message.body(states.state())
    assert (found["moves"], found["enabled"], found["latched"]) == (False, False, False)


def test_a_stop_that_does_not_reach_the_wheels_is_fatal() -> None:
    found = message.body(states.state(device=Device("/dev/x", "lost", "alive")))
    assert [(row["kind"], row["level"]) for row in found["errors"]] == [("wheels_may_turn", "fatal")]
    assert found["word"] == "MAY TURN"


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({"processes": {"gate": states.process(state="down")}}, "process_not_running"),
        ({"device": Device("x", "open", "unproven")}, "link_unproven"),
        ({"starved": Starved(0.09, "gate")}, "starved"),
        ({"arm": states.arm(wrong=("servo 3 is silent",))}, "arm"),
    ],
)
def test_warnings(changed: dict[str, Any], kind: str) -> None:
    (error,) = message.body(states.state(**changed))["errors"]
    assert (error["kind"], error["level"]) == (kind, "warning")


@pytest.mark.parametrize(
    ("volts", "age_s", "shown"),
    [
        (12.0, 0.1, {"volts": 12.0, "plugged": "plugged"}),
        (10.0, 0.1, {"volts": 10.0, "plugged": "plugged"}),
        (None, None, {"plugged": "plugged"}),
        (12.0, OLD_S, {}),
    ],
)
def test_what_is_old_or_unknown_about_the_battery_is_not_published(
    volts: float | None, age_s: float | None, shown: dict[str, Any]
) -> None:
    found = message.body(states.state(battery_v=volts, plugged="plugged", ages=Ages(battery_s=age_s)))
    assert found["battery"] == shown


def test_no_service() -> None:
    found = message.without_state(NoService("no service named 'x' is running"))
    assert [(row["kind"], row["level"]) for row in found["errors"]] == [("no_service", "fatal")]
    assert (found["word"], found["why"]) == ("NO SERVICE", "no service named 'x' is running")
    assert "moves" not in found, "nobody knows"
    roster = Roster()
    whole = message.Header("hall", "r1").message(topics.STATE, found, 1.0)
    roster.hear(topics.of_robot("hall", "r1", topics.STATE), whole, 0.0, retained=False)
    assert [(robot.word, robot.moves) for robot in roster.sorted()] == [("NO SERVICE", False)]
    assert "moves" not in message.steady(found)


def test_a_service_that_cannot_be_read_may_be_running() -> None:
    found = message.without_state(
        FailstopError("it has memory layout 12, this program 13"), (message.warning("a", "b", "c"),)
    )
    assert [row["kind"] for row in found["errors"]] == ["unreadable", "a"]
    assert (found["word"], found["why"]) == ("CAN'T READ", "it has memory layout 12, this program 13")
    assert "version" in found["next"]


def test_the_last_stop_has_its_proofs_and_those_that_are_not_known_are_left_out() -> None:
    stop = states.stop(observed_s=None)
    found = message.body(states.latched(last_stop=stop))["last_stop"]
    assert set(found) == {"cause", "reason", "t", "written_s", "acknowledged_s"}


def test_a_written_stop_that_the_board_may_not_have_says_so() -> None:
    stop = states.stop(acknowledged_s=None, observed_s=None)
    for flaw, doubtful in (("sent", replace(stop, sent=False)), ("believed", replace(stop, believed=False))):
        assert message.body(states.latched(last_stop=doubtful))["last_stop"][flaw] is False


def test_a_setting_of_vda_5050_is_refused_with_what_to_do_about_it() -> None:
    with pytest.raises(SettingError) as refused:
        FleetSettings({"robot.manufacturer": "acme"})
    text = str(refused.value)
    assert text.startswith("robot.manufacturer: failstop no longer publishes VDA 5050. Remove this line")
    assert "write robot.fleet instead" in text
    assert "robot.fleet" in BY_KEY
