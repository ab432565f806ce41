"""`failstop why`: for each block what holds, since when, what proves it, what to do."""

from __future__ import annotations

import dataclasses
import json

import pytest

from failstop.api import verdict, words
from failstop.api.events import Event
from failstop.api.snapshot import Block, Device, Starved, State
from failstop.api.why import HOLDS, Why, explain
from failstop.policy import causes
from failstop.web import view
from tests.support.states import NOW_S, SEEN, STILL, TURNS_ON, UNREAD, driving, latched, process, state, stop

STANDING = {"body_vel": (0.0, 0.0, 0.0), "wheels_radps": (0.0, 0.0, 0.0, 0.0), "turning": STILL}
DEAF = Device("/dev/ttyACM0", "open", "deaf")
LOST = Device("/dev/ttyACM0", "lost", "unproven")


def event(kind: str, text: str, age_s: float, step: str = "") -> Event:
    return Event(1, NOW_S - age_s, 0, kind, "notice", text, {}, step)


def why(found: State, *events: Event) -> Why:
    answer = explain(found, events, NOW_S)
    for text in (answer.what, answer.proof, *answer.do, *answer.also):
        assert text
        assert "  " not in text
        assert not text.endswith((".", ":", ";"))
    return answer


def test_a_latch_in_three_lines() -> None:
    found = why(latched(causes.REQUESTED("hand near", "failstop stop", 4711)))
    when = words.clock(NOW_S - 12, NOW_S)
    assert str(found).splitlines() == [
        f"what   a stop has been latched since {when}, 12 s ago: a program that says it is failstop stop (pid 4711) "
        'asked for a stop: "hand near"',
        "proof  written by the port owner after 0.21 ms, acknowledged by the board after 4.40 ms, "
        f"wheels still after about 0.3 s{SEEN}",
        "do     make sure that the reason for the stop is gone, then `failstop reset`, then `failstop enable`",
    ]
    assert (found.since, found.also) == (NOW_S - 12, ())


def test_proofs_that_are_missing_are_said_to_be() -> None:
    unseen = latched(last_stop=stop(acknowledged_s=None, observed_s=None))
    assert why(unseen).proof.endswith(f"NOT acknowledged by the board, NOT seen still by the IMU{SEEN}")
    assert explain(unseen, (), NOW_S - 11).proof.endswith(f"by the board yet, NOT seen still by the IMU yet{SEEN}")
    held = why(latched(last_stop=stop(sent=False, acknowledged_s=None))).proof
    assert held.startswith("NOT sent: the board accepts no bytes, NOT")
    unwritten = stop(written_s=None)
    assert why(latched(last_stop=unwritten)).proof.endswith(
        f"the port is open now, and the board is told to stop{SEEN}"
    )
    lost = why(latched(causes.DEVICE_LOST(), last_stop=stop(causes.DEVICE_LOST(), written_s=None), device=LOST))
    assert lost.proof == f"it could NOT be written{SEEN}"


def test_another_stop_than_the_latched_one_proves_nothing_of_it() -> None:
    found = why(latched(causes.KEY(1), last_stop=stop(causes.DIED("gate"))))
    assert (found.since, found.proof) == (None, f"the board answers{SEEN}")
    assert found.what.startswith("a stop is latched: ")


def test_disabled_since_the_event_that_made_it_so() -> None:
    past = (
        event("enabled", "motion enabled by nav (pid 42)", 60),
        event("disabled", "motion disabled by nav (pid 42)", 30),
        event("link", "the board answers", 20),
    )
    found = why(state(), *past)
    assert found.since == NOW_S - 30
    assert found.what.endswith("30 s ago: motion disabled by nav (pid 42)")
    assert found.do == ("`failstop enable`",)
    assert why(state()).since is None
    assert set(json.loads(json.dumps(dataclasses.asdict(found)))) == {"what", "proof", "do", "also", "since"}
    assert why(state(name="left", unmet="the arm is not folded")).do == (
        "satisfy the interlock (the arm is not folded)",
        "`failstop enable --name left`",
    )


def test_after_a_start_it_says_that_nobody_has_enabled_motion_yet() -> None:
    text = "'left' is ready: it has told the wheels to stop, and motion is disabled"
    ready = event("ready", text, 5.1, "`failstop enable`")
    when = words.clock(NOW_S - 5.1, NOW_S)
    found = why(state(name="left"), ready, event("link", "the board answers", 4))
    assert found.what == (
        f"motion has been disabled since {when}, 5.1 s ago: nobody has enabled motion since the service was started"
    )
    assert (found.since, found.do) == (NOW_S - 5.1, ("`failstop enable --name left`",))
    later = why(state(), ready, event("enabled", "motion enabled", 3), event("disabled", "motion disabled by nav", 2))
    assert "since the service was started" not in later.what


@pytest.mark.parametrize(
    ("kind", "text"),
    [("driver_gone", "motion disabled: nav (pid 42) died after it had driven"), ("reset", "latched stop cleared")],
)
def test_what_is_ready_again_hides_nothing(kind: str, text: str) -> None:
    again = event("ready", "a stop being carried out is there now: motion can be enabled again", 2)
    stopped = state(last_stop=stop())
    before, after = (why(stopped, event(kind, text, 6), *more) for more in ((), (again,)))
    assert after == before
    assert why(state(), again).since is None, "the start is no longer among the events"
    silent = event("driver_silent", "nav (pid 42) stopped sending commands while it drove", 6)
    assert verdict.left_off((silent, again)) is silent


def test_a_stop_before_the_reset_is_shown_with_its_proofs() -> None:
    began = event("ready", "no more", 20)
    reset = dataclasses.replace(event("reset", "pad: latched stop cleared", 6), seq=2)
    proof = why(state(last_stop=stop()), began, reset).proof
    assert proof.startswith(f"the last stop (key1; {words.ago(NOW_S - 12, NOW_S)}): written by the port owner")


@pytest.mark.parametrize(
    ("later", "its"),
    [
        ((), False),  # whether the wheels have turned since is not known
        ((dataclasses.replace(event("limit", "at most 90 %", 6), seq=300, ns=9),), False),
        ((event("limit", "at most 90 %", 6),), True),
        ((dataclasses.replace(event("limit", "at most 90 %", 13), seq=300),), True),
        ((event("stop", "STOP latched: key1", 12), event("reset", "pad: latched stop cleared", 6)), True),
        ((event("disabled", "motion disabled by nav (pid 42)", 6),), False),
        ((event("driver_gone", "motion disabled: nav (pid 42) died after it had driven", 6),), False),
    ],
)
def test_the_times_of_a_stop_are_shown_only_for_what_it_explains(later: tuple[Event, ...], its: bool) -> None:
    proof = why(state(last_stop=stop()), *later).proof
    assert ("0.21 ms" in proof) == its
    halts = any(it.kind in verdict.UNLATCHED for it in later)
    assert ("this stop was not timed" in proof) == halts


@pytest.mark.parametrize(
    ("blocked", "age_s", "part"),
    [
        ("cmd timeout", 2.5, "no program sends commands"),
        ("no scan", 2.5, "it last sent something 2.5 s ago"),
        ("no scan", None, "it has sent nothing in this run"),
    ],
)
def test_blocks_that_end_by_themselves(blocked: str, age_s: float | None, part: str) -> None:
    found = why(driving(blocked=blocked, scan_age_s=age_s, **STANDING))
    assert part in found.what
    assert found.proof == f"the board is told to stop; the board answers{SEEN}"
    assert HOLDS.keys() == set(Block)


def test_a_stop_that_the_kernel_still_holds_may_not_have_reached_the_wheels() -> None:
    """Every screen says so, and not the page alone."""
    held = latched(last_stop=stop(sent=False, acknowledged_s=None, observed_s=None))
    assert verdict.word(held) == verdict.MAY_TURN
    assert why(held).what.startswith("THE WHEELS MAY TURN (if they do: POWER SWITCH): the board accepts no bytes")
    assert verdict.word(driving(last_stop=held.last_stop)) == verdict.DRIVING, "what it obeys since is another question"


def test_nothing_holds_them() -> None:
    found = why(driving())
    assert found.what == "driving: nav (pid 42) commands 0.20 m/s forward"
    assert found.do == ()
    assert why(driving(**STANDING)).what.endswith("commands zero")


@pytest.mark.parametrize("found", [latched(causes.DEVICE_LOST(), device=LOST), state(device=DEAF)])
def test_wheels_that_may_turn_are_not_said_to_stand(found: State) -> None:
    answer = why(found)
    assert answer.what.startswith("THE WHEELS MAY TURN (if they do: POWER SWITCH): ")
    assert "wheels stand" not in str(answer)


DOUBTED = [kind for kind in causes.BY_NUMBER.values() if kind.doubt]


@pytest.mark.parametrize("kind", DOUBTED, ids=lambda kind: kind.name)
def test_the_power_switch_is_advised_until_the_stop_has_reached_the_wheels(kind: causes.Kind) -> None:
    """What a cause made people fear, and that the fear was settled since, are not said both at once."""
    cause = kind(*(1 for _ in kind.parameters))
    unheard = stop(cause, acknowledged_s=None, observed_s=None)
    feared = latched(cause, last_stop=unheard, turning=UNREAD)
    settled = latched(cause, last_stop=stop(cause, acknowledged_s=1.2, observed_s=1.4))
    for found, is_feared in ((feared, True), (settled, False)):
        answer = why(found)
        assert (kind.doubt in answer.what) == is_feared
        assert ("since" in answer.what.partition(": ")[2]) != is_feared
        assert ("POWER SWITCH" in " ".join(answer.do)) == is_feared
        assert "POWER SWITCH" not in str(cause)
        page = view.view(found, (), NOW_S)
        assert (kind.doubt in page["why"]) == is_feared
        assert ("POWER SWITCH" in page["next"]) == is_feared
        assert page["stop"]["reason"] == str(cause)
    assert "POWER SWITCH" in cause.alarm(), "in the moment itself it is said at once"


def test_wheels_that_turn_come_first_whatever_is_latched() -> None:
    for found in (state(turning=TURNS_ON), latched(turning=TURNS_ON), latched(causes.UNSTILL(), turning=TURNS_ON)):
        answer = why(found)
        shout = (
            "THE WHEELS TURN (use the POWER SWITCH, unless somebody pushes it): the wheels turn although they "
            "are told to stop; "
        )
        assert answer.what.startswith(shout)
        speeds = "front left +0.80, rear left +0.80, front right +0.80, rear right +0.80 turns/s"
        assert answer.proof.endswith(
            f"; now: the wheels turn although they are told to stop: {speeds} (by the board's reports, 0.0 s ago)"
        )
        switches = [step for step in answer.do if "POWER SWITCH" in step]
        assert switches == ["turn the robot's POWER SWITCH off and on, unless somebody pushes it"]


def test_troubles_are_told() -> None:
    gate = process(pid=0, state="down", last_exit="killed by SIGKILL", killed=True, starts_in_s=41.2)
    found = why(latched(causes.DIED("gate"), waiting_for="gate", processes={"gate": gate}))
    assert found.also == ("gate died too often and is down, after it was killed by SIGKILL; it starts again in 41 s",)
    assert found.do[1:] == ("wait 41 s for the gate", "`failstop reset`", "`failstop enable`")
    (starved,) = why(state(starved=Starved(0.612, "telemetry"))).also
    assert starved.startswith("the computer is too busy: telemetry did not run for 612 ms (`")
    waiting = process(state="waiting", last_exit="killed by SIGKILL", killed=True)
    assert why(state(waiting_for="gate", processes={"gate": waiting})).also == (
        "gate is waiting, after it was killed by SIGKILL",
    )
    assert why(state(waiting_for="the port")).do[0] == "wait for the port"
    assert "said nothing for 3.0 s" in why(state(age_s=3.0)).also[0]


def test_a_board_that_never_answered_proves_nothing() -> None:
    found = why(state(device=Device("/dev/ttyACM0", "open", "unproven")))
    assert found.what == "STOPPED, unproven: the board has never answered; motion is disabled"
    assert found.proof == f"the board is told to stop; the board has never answered{SEEN}"
    [also] = found.also
    assert also.startswith("the board has never answered, so no stop is known to reach the wheels: check its power")
    assert "`failstop doctor` shows whether a login or another program takes the answers" in also


def test_a_board_that_answers_nothing_by_its_nature_is_not_warned_of() -> None:
    unasked = Device("/dev/ttyACM0", "open", "unasked")
    found = why(latched(device=unasked, last_stop=stop(acknowledged_s=None, acknowledged_by="")))
    assert found.what.startswith("a stop has been latched since ")
    assert "this board never acknowledges a stop, wheels still after about 0.3 s" in found.proof
    assert found.also == ()


def test_a_command_that_the_board_says_it_does_not_obey_is_no_driving() -> None:
    """Its echo is zero: the command wire is broken, or its own watchdog has acted."""
    deaf, young = (driving(device=Device("/dev/ttyACM0", "open", "unasked", unheeded_s=for_s)) for for_s in (0.8, 0.3))
    found = why(deaf)
    assert "driving" not in str(found)
    assert found.what == (
        "COMMANDED TO DRIVE, unproven: the board has reported for 0.8 s that it obeys a command of zero; nav (pid 42) "
        "commands 0.20 m/s forward"
    )
    assert verdict.large_word(deaf) == "MOVING, UNPROVEN"
    assert "driving: " in why(young).what, "it may be on its way"


def test_an_echo_that_ended_no_motion_is_no_acknowledgement() -> None:
    unasked = Device("/dev/ttyACM0", "open", "unasked")
    told = why(latched(device=unasked, last_stop=stop(acknowledged_by="echo", acknowledged_s=None))).proof
    assert "not acknowledged, because this board's echo shows only a stop that ends motion" in told
