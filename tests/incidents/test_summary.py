"""The summary: what matters fits a terminal of 24 lines, whatever else was recorded."""

from __future__ import annotations

import re

import pytest

from failstop.board.rrc.board import BOARD
from failstop.cli.screen import incident as screen
from failstop.incidents import story
from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE
from failstop.policy import causes
from failstop.policy.causes import Cause
from tests.support.incident_parts import UNIX_NS, Recorder, at, drive_and_die, printed

TERMINAL_LINES = 24


def shown(made: Recorder, columns: int = 80) -> list[str]:
    return printed(screen.text(made.incident(), columns, UNIX_NS / 1e9 + 300)).splitlines()


def fact(made: Recorder, name: str) -> str:
    text = "\n".join(shown(made, 200))
    found = re.search(rf"^  {name} +(.*)$", text, re.M)
    assert found, text
    return found[1]


def chosen(incident: Incident) -> list[tuple[str, str]]:
    return [(line.what, line.text) for line in story.brief(incident)]


def test_what_matters_is_seen_without_scrolling() -> None:
    made = drive_and_die()
    for ms in range(-2500, 2000, 30):
        made.event(ms, "note", f"a word at {ms}")
        made.cause(ms, causes.PIPED(f"number {ms}"))
    lines = shown(made)
    assert len(lines) < TERMINAL_LINES, "and a line for the prompt"
    assert [line for line in lines if line.startswith(">>")] == [">>         0  CAUSE       gate died"]
    assert lines[-1] == screen.MORE


def test_the_lines_that_lead_to_it_and_come_of_it_are_in_order() -> None:
    assert chosen(drive_and_die().incident()) == [
        ("enabled", "motion enabled by nav (pid 77)"),
        ("command", "nav (pid 77) as cmd_vel: 0.20 m/s forward"),
        ("gate", "lets the wheels turn"),
        ("gate", "no tick for 2212 ms from here"),
        (CAUSE, "gate died"),
        ("wire", "STOP BURST by the port owner"),
        ("died", "! gate (pid 102) was killed by SIGKILL"),
        ("beat", "last beat of the gate for 190 ms"),
    ]


def test_what_was_before_a_reset_belongs_to_another_stop() -> None:
    made = drive_and_die()
    made.event(-2000, "died", "stopper (pid 103) was killed by SIGKILL", "error", process="stopper", pid=103)
    assert ("died", "! stopper (pid 103) was killed by SIGKILL") in chosen(made.incident())
    said = "nav (pid 77): latched stop cleared (was: stopper died); motion still disabled"
    made.event(-1500, "reset", said, step="`failstop enable`")
    told = chosen(made.incident())
    assert ("died", "! stopper (pid 103) was killed by SIGKILL") not in told
    assert ("reset", said) in told
    assert ("enabled", "motion enabled by nav (pid 77)") not in told


def test_a_stop_in_other_words_that_contain_the_cause_is_a_line_of_its_own() -> None:
    made = drive_and_die()
    said = "STOP latched: stop request: gate died; stop frame written by the port owner after 90 us"
    made.event(900, "stop", said, "warning", reason="stop request: gate died", cause="piped")
    assert ("stop", said) in chosen(made.incident())
    assert len([line for line in chosen(made.incident()) if line[0] == "stop"]) == 1


def test_a_motion_frame_after_the_cause_is_never_left_out() -> None:
    made = drive_and_die()
    made.frame(300, BOARD.motor_speeds((1, 1, -1, -1), 5.0))
    assert ("wire", "motion [+1.000 +1.000 -1.000 -1.000] rps") in chosen(made.incident())


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (causes.REQUESTED("too near", "nav", 12), "stop request: too near"),
        (causes.REQUESTED("", "nav", 12), "stop request"),
        (causes.REQUESTED("a (b) c", "my, node", 12), "stop request: a (b) c"),
        (causes.PIPED("near (nav, pid 12)"), "stop request: near (nav, pid 12)"),
        (causes.PIPED(""), "stop request"),
        (causes.FLEET("smoke in hall 2", "ann"), "fleet stop: smoke in hall 2 (by ann)"),
        (causes.DIED("gate"), "gate died"),
        (causes.NOT_FINITE("nav (pid 77)"), "command from nav (pid 77) is not finite"),
    ],
    ids=repr,
)
def test_a_cause_without_who_asked_for_it(cause: Cause, text: str) -> None:
    assert Recorder(cause).incident().why == text


def test_who_asked_for_a_stop_and_who_noticed_it_are_two() -> None:
    made = Recorder(causes.REQUESTED("hand near wheel", "failstop estop", 9))
    assert fact(made, "why") == "stop request: hand near wheel"
    assert fact(made, "noticed") == "by the port owner; asked for by failstop estop (pid 9)"


def test_since_when_the_wheels_stood() -> None:
    made = Recorder(causes.PIPED("somebody looked"))
    made.core.enable(7, "", at(-3000))
    for ms in range(-3000, -2000, 20):
        made.core.scan.deliver(at(ms), at(ms))
        made.command(ms, (0.2, 0.0, 0.0))
        made.tick(ms)
    for ms in range(-2000, 0, 20):
        made.core.scan.deliver(at(ms), at(ms))
        made.tick(ms)
    assert fact(made, "before") == "the wheels stood (no command), for 1.7 s"


def test_a_cause_is_there_even_when_nothing_else_is() -> None:
    assert [what for what, _ in chosen(Recorder().incident())] == [CAUSE]
