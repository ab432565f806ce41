"""The paragraph: for each block reason what holds, since when, what proves it, what clears it."""

from __future__ import annotations

import pytest

from failstop.api.events import Event
from failstop.api.snapshot import Device, Starved
from failstop.cli.screen import paragraph, words
from failstop.policy import causes
from tests.support.states import NOW_S, driving, latched, process, state, stop

STANDING = {"body_vel": (0.0, 0.0, 0.0), "wheels_radps": (0.0, 0.0, 0.0, 0.0)}
LOST = Device("/dev/ttyACM0", "lost", "unproven")


def event(kind: str, text: str, age_s: float) -> Event:
    return Event(1, NOW_S - age_s, 0, kind, "notice", text, {})


def text(found: paragraph.Explanation) -> str:
    assert "  " not in found.text
    assert ".." not in found.text
    return found.text


def test_a_latch() -> None:
    found = paragraph.explain(latched(causes.REQUESTED("hand near", "failstop estop", 4711)), [], NOW_S)
    said = text(found)
    for part in (
        f"The wheels stand since {words.clock(NOW_S - 12, NOW_S)}, 12 s ago: a stop is latched",
        'because failstop estop (pid 4711) asked for a stop: "hand near".',
        "written to the port by the port owner 0.21 ms after its cause was noticed",
        "the board acknowledged it after 4.40 ms and the IMU showed the wheels still after about 0.3 s",
        "then `failstop reset`, then `failstop enable`",
        "A reset clears the latch alone",
    ):
        assert part in said
    assert (found.blocked, found.since) == ("estop: stop request: hand near (failstop estop, pid 4711)", NOW_S - 12)
    assert found.next == ["`failstop reset`", "`failstop enable`"]


def test_proofs_that_are_missing_are_said_to_be() -> None:
    unseen = stop(acknowledged_s=None, observed_s=None)
    assert "has not acknowledged it and the IMU has not shown the wheels still." in text(
        paragraph.explain(latched(last_stop=unseen), [], NOW_S)
    )
    assert "has not acknowledged it yet" in text(paragraph.explain(latched(last_stop=unseen), [], NOW_S - 11))
    unwritten = stop(written_s=None)
    assert "told zero 5 times a second" in text(paragraph.explain(latched(last_stop=unwritten), [], NOW_S))
    lost = text(paragraph.explain(latched(causes.DEVICE_LOST(), last_stop=unwritten, device=LOST), [], NOW_S))
    assert "told zero" not in lost


def test_another_stop_than_the_latched_one_proves_nothing_of_it() -> None:
    found = paragraph.explain(latched(causes.KEY(1), last_stop=stop(causes.DIED("gate"))), [], NOW_S)
    assert (found.since, found.proof) == (None, "")
    assert text(found).startswith("The wheels stand: a stop is latched")


def test_disabled_since_the_event_that_made_it_so() -> None:
    past = [
        event("enabled", "motion enabled by nav (pid 42)", 60),
        event("disabled", "motion disabled by nav (pid 42)", 30),
        event("link", "the board answers", 20),
    ]
    found = paragraph.explain(state(), past, NOW_S)
    assert found.since == NOW_S - 30
    assert "30 s ago: motion is disabled" in text(found)
    assert "What was said then: motion disabled by nav (pid 42)." in text(found)
    assert "What to do: `failstop enable`." in text(found)
    assert paragraph.explain(state(), [], NOW_S).since is None


@pytest.mark.parametrize(
    ("blocked", "part"),
    [
        ("cmd timeout", "nobody commands"),
        ("no scan", "it delivered last 2.5 s ago. What to do: start the obstacle sensor"),
    ],
)
def test_blocks_that_end_by_themselves(blocked: str, part: str) -> None:
    said = text(paragraph.explain(driving(blocked=blocked, scan_age_s=2.5, **STANDING), [], NOW_S)).lower()
    assert part.lower() in said
    assert paragraph.BLOCKS[blocked].clears in said


def test_a_sensor_that_never_delivered() -> None:
    said = text(paragraph.explain(driving(blocked="no scan", **STANDING), [], NOW_S))
    assert "not delivered once" in said


def test_nothing_holds_them() -> None:
    found = paragraph.explain(driving(), [], NOW_S)
    assert text(found) == "Nothing holds the wheels: nav (pid 42) drives as cmd_vel, 0.20 m/s forward."
    assert found.blocked is None
    assert "zero, so the wheels stand" in text(paragraph.explain(driving(**STANDING), [], NOW_S))


@pytest.mark.parametrize(
    "found",
    [
        latched(causes.DEVICE_LOST(), device=LOST),
        state(device=Device("/dev/ttyACM0", "open", "deaf")),
        latched(causes.UNSTILL()),
    ],
)
def test_wheels_that_may_turn_are_not_said_to_stand(found: object) -> None:
    said = text(paragraph.explain(found, [], NOW_S))  # type: ignore[arg-type]
    assert said.startswith("THE WHEELS MAY TURN: ")
    assert "POWER SWITCH" in said
    assert "the wheels stand" not in said.lower().replace("so the wheels stand", "")


def test_troubles_are_told() -> None:
    gate = process(pid=0, state="down", last_exit="killed by SIGKILL")
    said = text(
        paragraph.explain(latched(causes.DIED("gate"), waiting_for="gate", processes={"gate": gate}), [], NOW_S)
    )
    assert "gate died too often (it was killed by SIGKILL) and is down for a minute" in said
    assert "wait for gate, then `failstop reset`, then `failstop enable`" in said
    found = Starved(3, 0.612, "telemetry")
    starved = text(paragraph.explain(state(starved=found), [], NOW_S))
    assert "The machine starved the service 3 times, at worst telemetry for 612 ms (`failstop doctor` has" in starved
    waiting = process(state="waiting", last_exit="killed by SIGKILL")
    assert "gate is waiting, after it was killed" in text(
        paragraph.explain(state(waiting_for="gate", processes={"gate": waiting}), [], NOW_S)
    )
    assert "waits for a stop being carried out" in text(
        paragraph.explain(state(waiting_for="a stop being carried out"), [], NOW_S)
    )
    unproven = Device("/dev/ttyACM0", "open", "unproven")
    assert "nobody knows that it hears" in text(paragraph.explain(state(device=unproven), [], NOW_S))
    assert "said nothing for 3.0 s" in text(paragraph.explain(state(age_s=3.0), [], NOW_S))


def test_for_programs() -> None:
    assert set(paragraph.explain(latched(), [], NOW_S).as_dict()) == {
        "blocked",
        "since",
        "cause",
        "proof",
        "next",
        "text",
    }
