"""A robot in the words of VDA 5050."""

from __future__ import annotations

import json
from typing import Any

import pytest

from failstop.api.snapshot import OLD_S, Ages, Device, Source, Starved
from failstop.api.state import State
from failstop.fleet import topics, vda5050
from failstop.policy import causes
from tests.support import states

REQUIRED = {
    *("headerId", "timestamp", "version", "manufacturer", "serialNumber"),
    *("orderId", "orderUpdateId", "lastNodeId", "lastNodeSequenceId", "nodeStates", "edgeStates", "driving"),
    *("actionStates", "batteryState", "operatingMode", "errors", "safetyState"),
}
"""Fields of a state, by the schema of 2.1.0."""
OPTIONAL = {"paused", "velocity", "information"}


def body(state: State | None, note: str = "") -> dict[str, Any]:
    return vda5050.body(state, note)


def told(found: dict[str, Any], kind: str) -> str:
    (text,) = (row["infoDescription"] for row in found["information"] if row["infoType"] == kind)
    return str(text)


@pytest.mark.parametrize("state", [states.state(), states.latched(), states.driving(), None])
def test_a_state_has_every_field_that_is_required_and_none_that_is_unknown(state: State | None) -> None:
    found = json.loads(vda5050.Header("m", "r").message("state", body(state), 0.0))
    assert set(found) >= REQUIRED
    assert set(found) <= REQUIRED | OPTIONAL


def test_a_header_counts_by_topic() -> None:
    header = vda5050.Header("maker", "r1")
    numbers = [json.loads(header.message(last, {}, 0.5))["headerId"] for last in ("a", "a", "b", "a")]
    assert numbers == [0, 1, 0, 2]
    found = json.loads(header.message("b", {}, 0.5))
    assert (found["timestamp"], found["version"]) == ("1970-01-01T00:00:00.500Z", "2.1.0")
    assert (found["manufacturer"], found["serialNumber"]) == ("maker", "r1")
    assert header.topic("state") == "uagv/v2/maker/r1/state"
    assert topics.robot_of(header.topic("state")) == ("r1", "state")
    assert vda5050.seconds(found["timestamp"]) == 0.5
    assert vda5050.seconds("yesterday") is None


def test_a_stop_that_is_latched_is_acknowledged_at_the_robot() -> None:
    found = body(states.latched(causes.DIED("gate")))
    assert found["safetyState"] == {"eStop": "MANUAL", "fieldViolation": False}
    (error,) = found["errors"]
    assert (error["errorType"], error["errorLevel"]) == ("stopLatched", "FATAL")
    assert error["errorDescription"] == "gate died"
    assert {"referenceKey": "cause", "referenceValue": "died"} in error["errorReferences"]
    assert "`failstop reset`" in error["errorHint"]
    assert (told(found, "word"), told(found, "why")) == ("STOPPED", "gate died")
    assert not found["paused"], "it can't be resumed"


def test_driving() -> None:
    found = body(states.driving())
    assert found["driving"]
    assert found["velocity"] == {"vx": 0.2, "vy": 0.0, "omega": 0.0}
    assert found["operatingMode"] == "AUTOMATIC"
    assert found["errors"] == []
    assert found["safetyState"]["eStop"] == "NONE"
    assert (told(found, "word"), told(found, "why")) == ("DRIVING", "0.20 m/s forward")


def test_a_person_drives() -> None:
    source = Source("gamepad", 101, "gamepad", "drives")
    assert body(states.driving(sources=(source,)))["operatingMode"] == "MANUAL"


def test_disabled_is_paused_and_not_ready_is_service() -> None:
    assert body(states.state())["paused"]
    assert body(states.state(waiting_for="gate"))["operatingMode"] == "SERVICE"


def test_a_stop_that_does_not_reach_the_wheels_is_fatal() -> None:
    found = body(states.state(device=Device("/dev/x", "lost", "alive")))
    assert [row["errorType"] for row in found["errors"]] == ["wheelsMayTurn"]
    assert found["errors"][0]["errorLevel"] == "FATAL"
    assert told(found, "word") == "MAY TURN"


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({"processes": {"gate": states.process(state="down")}}, "processNotRunning"),
        ({"device": Device("x", "open", "unproven")}, "linkUnproven"),
        ({"starved": Starved(0.09, "gate")}, "starved"),
        ({"arm": states.arm(wrong=("servo 3 is silent",))}, "arm"),
    ],
)
def test_warnings(changed: dict[str, Any], kind: str) -> None:
    (error,) = body(states.state(**changed))["errors"]
    assert (error["errorType"], error["errorLevel"]) == (kind, "WARNING")


@pytest.mark.parametrize(("volts", "charge"), [(12.0, 80.0), (10.0, 20.0), (None, 0.0)])
def test_the_battery(volts: float | None, charge: float) -> None:
    found = body(states.state(battery_v=volts, plugged="plugged"))["batteryState"]
    assert found["batteryCharge"] == charge
    assert found.get("batteryVoltage") == volts
    assert found["charging"] is True


def test_an_old_battery_voltage_is_not_sent() -> None:
    found = body(states.state(battery_v=12.0, ages=Ages(battery_s=OLD_S)))
    assert "batteryVoltage" not in found["batteryState"]
    assert told(found, "battery") == "not known"


def test_no_service() -> None:
    found = body(None, "no service named 'x' is running")
    assert [row["errorType"] for row in found["errors"]] == ["noService"]
    assert (told(found, "word"), told(found, "why")) == ("NO SERVICE", "no service named 'x' is running")
    assert found["operatingMode"] == "SERVICE"


def test_the_last_stop_has_its_proofs_and_those_that_are_not_known_are_left_out() -> None:
    stop = states.stop(observed_s=None)
    (row,) = (row for row in body(states.latched(last_stop=stop))["information"] if row["infoType"] == "lastStop")
    found = {pair["referenceKey"]: pair["referenceValue"] for pair in row["infoReferences"]}
    assert set(found) == {"cause", "t", "written_s", "acknowledged_s"}
