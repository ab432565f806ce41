"""The page's view of a state: the word, one reason, one step, and what stands in the way of a button."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest

from failstop.api.snapshot import Device
from failstop.api.state import State
from failstop.policy import causes
from failstop.web import view
from tests.support import states
from tests.support.states import NOW_S

PORT = Device("/dev/ttyACM0", "open", "alive")
UNPROVEN = dataclasses.replace(PORT, link="unproven")
DEAF = dataclasses.replace(PORT, link="deaf")
UNPROVEN = dataclasses.replace(PORT, link="unproven")
WRITTEN = states.stop(acknowledged_s=None, observed_s=None)
HELD = states.stop(acknowledged_s=None, observed_s=None, sent=False)
UNFELT = states.stop(acknowledged_s=None, observed_s=0.0)
"""The IMU felt nothing, before the stop or after it."""
SEEN = states.stop(acknowledged_s=None, observed_s=0.3)
DRIVING = {"enabled": True, "blocked": None, "body_vel": (0.2, 0.0, 0.0), "wheels_radps": (6.0, 6.0, 6.0, 6.0)}


def shown(state: State) -> dict[str, Any]:
    return view.view(state, [], NOW_S)


@pytest.mark.parametrize(
    ("state", "word", "why", "step"),
    [
        (states.state(), "STOPPED", "Motion is disabled", "Hold ENABLE"),
        (states.state(device=UNPROVEN), "STOPPED, UNPROVEN", "The board has never answered. Motion is", "Hold ENABLE"),
        (states.state(unmet="it is open"), "STOPPED", "Motion is disabled", "the interlock (it is open)."),
        (states.state(attended_by=()), "STOPPED", "Motion is disabled", "press ATTEND"),
        (
            states.state(enabled=True, blocked="cmd timeout"),
            "CAN MOVE",
            "no program sends commands",
            "Start your driving program",
        ),
        (states.state(enabled=True, blocked="no scan"), "CAN MOVE", "sensor is silent", "Start the obstacle sensor"),
        (states.state(**DRIVING), "MOVING", "0.20 m/s forward.", ""),
        (states.state(enabled=True, blocked=None), "CAN MOVE", "The command is zero.", ""),
        (states.latched(), "STOPPED", "Somebody pressed key 1 on the board.", "then hold RESET"),
        (states.state(waiting_for="the port"), "STOPPED", "Motion is disabled", "Wait for the port."),
        (states.state(device=dataclasses.replace(PORT, state="lost")), "WHEELS MAY TURN", "is lost", "POWER SWITCH"),
        (states.latched(device=DEAF), "WHEELS MAY TURN", "does not hear", "POWER SWITCH"),
        (states.latched(causes.UNSTILL()), "STOPPED", "shake as if they did", "then hold RESET"),
        (
            states.latched(turning=states.TURNS_ON),
            "WHEELS TURN",
            "although they are told to stop",
            "unless somebody pushes",
        ),
        (states.state(turning=states.MOVES_ON), "ROBOT MOVES", "or is being moved", "unless somebody moves it."),
        (states.latched(turning=states.TURNS), "STOPPING", "but still turn. Somebody pressed", "hold RESET"),
        (states.state(turning=states.UNSEEN), "TOLD TO STOP", "nothing reports what they do. Motion is", "Hold ENABLE"),
        (states.latched(last_stop=WRITTEN), "STOP WRITTEN", "pressed key 1", "then hold RESET"),
        (states.latched(last_stop=WRITTEN, device=UNPROVEN), "STOP WRITTEN", "pressed key 1", "POWER SWITCH"),
        (states.latched(last_stop=UNFELT), "STOP WRITTEN", "pressed key 1", "then hold RESET"),
        (states.latched(last_stop=SEEN, device=UNPROVEN), "STOPPED, UNPROVEN", "pressed key 1", "then hold RESET"),
        (states.state(last_stop=WRITTEN), "STOP WRITTEN", "Motion is disabled", "Hold ENABLE"),
        (states.latched(last_stop=HELD), "WHEELS MAY TURN", "accepts no bytes, so the last stop", "POWER SWITCH"),
        (states.latched(last_stop=None), "WHEELS MAY TURN", "pressed key 1", "POWER SWITCH"),
    ],
)
def test_word_reason_and_step(state: State, word: str, why: str, step: str) -> None:
    found = shown(state)
    assert found["word"] == word
    assert why in found["why"]
    assert step in found["next"]
    assert bool(step) == bool(found["next"])
    json.dumps(found)


@pytest.mark.parametrize(
    "state",
    [states.state(), states.latched(), states.latched(last_stop=WRITTEN), states.state(attended_by=())],
    ids=["disabled", "latched", "written", "nobody-attends"],
)
def test_a_device_without_buttons_is_told_of_none(state: State) -> None:
    found = shown(state)
    assert any(button in found["next"] for button in ("RESET", "ENABLE", "ATTEND"))
    assert not any(button in found["next_unpaired"] for button in ("RESET", "ENABLE", "ATTEND"))
    assert "a paired device or failstop " in found["next_unpaired"]


def test_a_device_with_the_stick_is_told_to_use_it() -> None:
    found = shown(states.state(enabled=True, blocked="cmd timeout"))
    assert found["next_driver"] == "Hold the stick to drive."
    assert found["next"] == "Start your driving program."
    assert found["next_unpaired"] == "Start your driving program."


@pytest.mark.parametrize("kind", causes.BY_NUMBER.values(), ids=lambda kind: kind.name)
def test_every_cause_is_a_sentence_and_a_step(kind: causes.Kind) -> None:
    given: dict[type, Any] = {str: "gate", int: 1, float: 1.0}
    cause = kind(*(given[of] for _, of in kind.parameters))
    found = shown(states.latched(cause))
    assert found["why"].endswith(".")
    assert found["why"][0].isupper() or found["why"][0] in "\"'"
    assert found["next"].endswith(".")
    assert "`" not in found["why"] + found["next"]
    assert found["latched"]


def test_what_stands_in_the_way() -> None:
    def can(state: State) -> dict[str, str]:
        found: dict[str, str] = shown(state)["can"]
        return found

    assert can(states.state()) == {
        "reset": "nothing is latched", "enable": "", "disable": "motion is disabled already"
    }  # fmt: skip
    assert can(states.latched()) == {
        "reset": "", "enable": "a stop is latched: reset first", "disable": "motion is disabled already"
    }  # fmt: skip
    assert can(states.state(**DRIVING))["disable"] == ""
    assert can(states.state(waiting_for="the gate"))["enable"] == "wait for the gate"
    assert can(states.state(attended_by=()))["enable"] == "somebody has to attend: press ATTEND"
    assert can(states.state(unmet="it is open"))["enable"] == "satisfy the interlock (it is open)"
    assert can(states.latched(device=DEAF))["reset"] == ""


def test_the_three_levels_of_a_stop() -> None:
    stop = states.stop(acknowledged_s=None, observed_s=None)
    assert view.stop_of(stop) == {
        "reason": "key1", "t": NOW_S - 12, "written": "0.21 ms", "acknowledged": "", "observed": "",
        "lacks": {"written": "NO: the board accepts no bytes", "acknowledged": "", "observed": ""},
    }  # fmt: skip
    assert view.stop_of(None) is None


@pytest.mark.parametrize(
    ("changed", "level", "lacks"),
    [
        ({"written_s": None}, "written", "NO: it could not be written"),
        ({"sent": False}, "written", "NO: the board accepts no bytes"),
        ({"acknowledged_s": None, "acknowledged_by": ""}, "acknowledged", "this board never does"),
        ({"observed_s": 0.0}, "observed", "no shaking seen before or after"),
        ({"observed_s": 0.0, "observed_by": "wheels"}, "observed", "not seen turning before or after"),
        ({"observed_s": None, "observed_by": ""}, "observed", "no IMU"),
    ],
)
def test_a_level_that_is_not_proved_has_no_time_and_says_what_is_known(
    changed: dict[str, Any], level: str, lacks: str
) -> None:
    """The page ticks off a level that has a time."""
    found = view.stop_of(states.stop(**changed))
    assert found
    assert (found[level], found["lacks"][level]) == ("", lacks)


@pytest.mark.parametrize(
    ("device", "says"),
    [
        (PORT, "The board answers."),
        (DEAF, "The board does NOT hear."),
        (dataclasses.replace(PORT, link="silent"), "The board says NOTHING any more."),
        (dataclasses.replace(PORT, link="unheard"), "The board has NOT answered since its port came back."),
        (dataclasses.replace(PORT, state="lost", link="unheard"), "not known"),
    ],
)
def test_what_is_known_of_the_board_is_in_words(device: Device, says: str) -> None:
    assert shown(states.state(device=device))["board"] == says


def test_without_a_service() -> None:
    found = view.absent("no service named 'left' is running")
    assert found.keys() == shown(states.state()).keys()
    assert found["word"] == "NO SERVICE"
    assert "POWER SWITCH" in found["next"].upper()
