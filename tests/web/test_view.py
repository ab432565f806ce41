"""The page's view of a state: the word, one reason, one step, and what stands in the way of a button."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest

from failstop.api.events import Event
from failstop.api.snapshot import Device, Source, Turning
from failstop.api.state import State, Stop
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


def shown(state: State, *events: Event) -> dict[str, Any]:
    return view.view(state, events, NOW_S)


def event(kind: str, text: str, age_s: float) -> Event:
    """An event that came after every stop of the tests' states."""
    return Event(1, NOW_S - age_s, 1, kind, "warning", text, {})


DEATH = "motion disabled: nav (pid 42) died after it had driven"


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


BY_WHEELS = dataclasses.replace(states.STILL, by="wheels")


@pytest.mark.parametrize(
    ("stop", "turning", "age_s", "word"),
    [
        pytest.param(WRITTEN, BY_WHEELS, 5.0, "STOPPED", id="an earlier stop was only written"),
        pytest.param(states.stop(), BY_WHEELS, 5.0, "STOPPED", id="an earlier stop was proved"),
        pytest.param(None, BY_WHEELS, 5.0, "STOPPED", id="no earlier stop"),
        pytest.param(WRITTEN, states.UNREAD, 5.0, "TOLD TO STOP", id="nothing was read since"),
        pytest.param(states.stop(), states.TURNS, 5.0, "STOPPING", id="they turn"),
        pytest.param(
            states.stop(),
            dataclasses.replace(BY_WHEELS, age_s=0.3),
            0.2,
            "TOLD TO STOP",
            id="the report is from before the disable",
        ),
        pytest.param(
            states.stop(), states.STILL, 0.4, "TOLD TO STOP", id="the window of the IMU began before the disable"
        ),
        pytest.param(states.stop(), states.STILL, 0.6, "STOPPED", id="the window of the IMU is from after it"),
        pytest.param(states.stop(), states.STILL, -9.0, "STOPPED", id="the clock was set back since"),
    ],
)
def test_after_a_later_disable_the_word_is_what_was_seen_since(
    stop: Stop | None, turning: Turning, age_s: float, word: str
) -> None:
    found = shown(states.state(last_stop=stop, turning=turning), event("driver_gone", DEATH, age_s))
    assert found["word"] == word
    assert ("nothing shows what they do now" in found["why"]) == (word == "TOLD TO STOP")
    assert "POWER SWITCH" not in found["next"].upper()


def test_a_reading_from_before_the_stop_does_not_say_that_it_has_stopped_the_wheels() -> None:
    turning = dataclasses.replace(BY_WHEELS, age_s=0.3)
    assert shown(states.latched(last_stop=states.stop(t=NOW_S - 0.2), turning=turning))["word"] == "TOLD TO STOP"
    assert shown(states.latched(last_stop=states.stop(t=NOW_S - 0.4), turning=turning))["word"] == "STOPPED"


def test_the_last_stop_of_the_page_is_what_stopped_the_wheels_last() -> None:
    death = event("driver_gone", DEATH, 5.0)
    found = shown(states.state(last_stop=states.stop()), death)["unlatched"]
    untimed = "this stop was not timed: failstop times only latched stops"
    assert found == {"reason": DEATH, "t": NOW_S - 5.0, "lacks": untimed}
    assert shown(states.latched(), death)["unlatched"] is None
    assert shown(states.state(last_stop=states.stop(noticed_ns=2)), death)["unlatched"] is None
    assert shown(states.state(last_stop=states.stop()), event("limit", "at most 90 %", 5.0))["unlatched"] is None
    assert shown(states.state())["unlatched"] is None
    lost = dataclasses.replace(event("limit", "at most 90 %", 5.0), seq=300)
    found = shown(states.state(last_stop=states.stop()), lost)["unlatched"]
    assert (found["reason"], found["t"]) == ("not known", None)


def held(source: str, who: str) -> dict[str, Any]:
    sources = (Source(source, 0, who, "held"),)
    return shown(states.state(enabled=True, blocked="let go first", sources=sources))


@pytest.mark.parametrize(
    ("source", "who"),
    [("gamepad", "gamepad"), ("page", "Anna (page) (pid 77)"), ("cmd_vel", "Anna (page) (pid 77)")],
)
def test_a_stick_that_is_held_is_to_be_let_go(source: str, who: str) -> None:
    found = held(source, who)
    assert found["why"] == "Let go of the stick, then push it again: it was pushed before motion was enabled."
    assert {found[key] for key in ("next", "next_driver", "next_unpaired")} == {
        "Let go of the stick, then push it again."
    }


def test_a_program_that_is_held_has_no_stick() -> None:
    found = held("cmd_vel", "nav (pid 42)")
    assert found["why"] == (
        "Motion is enabled, but nav (pid 42) commanded before that, so it must send zero or pause before it can drive."
    )
    assert found["next"] == "Have nav (pid 42) send zero or pause, or end it, hold ENABLE and start it again."
    assert found["next_unpaired"] == (
        "Have nav (pid 42) send zero or pause, or end it, enable motion with a paired device or failstop enable, and "
        "start it again."
    )
    unnamed = shown(states.state(enabled=True, blocked="let go first"))
    assert "stick" not in unnamed["why"] + unnamed["next"]


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
        "id": str(stop.noticed_ns), "reason": "key1", "t": NOW_S - 12,
        "written": "0.21 ms", "acknowledged": "", "observed": "",
        "lacks": {"written": "NO: the board accepts no bytes", "acknowledged": "", "observed": ""},
    }  # fmt: skip
    assert view.stop_of(None) is None


def test_a_clock_that_is_set_makes_no_new_stop() -> None:
    """The page takes another `id` for a stop that was latched since somebody pressed STOP."""
    before, after = (view.stop_of(states.stop(t=t, noticed_ns=7)) for t in (NOW_S, NOW_S + 3600.0))
    assert before
    assert after
    assert (before["id"], before["t"] == after["t"]) == (after["id"], False)


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


def test_a_run_is_not_known_by_its_pids() -> None:
    """In a container they are the same in each run."""
    assert shown(states.state(run="a"))["run"] != shown(states.state(run="b"))["run"]


def test_without_a_service() -> None:
    found = view.absent("no service named 'left' is running")
    assert found.keys() == shown(states.state()).keys()
    assert found["word"] == "NO SERVICE"
    assert "POWER SWITCH" in found["next"].upper()


def test_a_service_that_can_not_be_read_is_not_said_to_be_absent() -> None:
    found = view.absent("the supervisor's memory is of another version", gone=False)
    assert found.keys() == shown(states.state()).keys()
    assert found["word"] == "CAN'T READ"
    assert "no service" not in str(found).lower()
    assert "POWER SWITCH" in found["next"].upper()
