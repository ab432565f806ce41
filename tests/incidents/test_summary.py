"""The summary: what matters fits a terminal of 24 lines, whatever else was recorded."""

from __future__ import annotations

import re

import pytest

from failstop.board.interface import BOARD
from failstop.incidents import report, story
from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE
from failstop.policy import causes
from tests.support.incident_parts import CAUSE_NS, UNIX_NS, Recorder, at, drive_and_die, printed

TERMINAL_LINES = 24


def shown(made: Recorder, columns: int = 80) -> list[str]:
    return printed(report.summary(made.incident(), columns, at(-10_000), UNIX_NS / 1e9 + 300)).splitlines()


def fact(made: Recorder, name: str) -> str:
    text = "\n".join(shown(made, 200))
    found = re.search(rf"^  {name} +(.*)$", text, re.M)
    assert found, text
    return found[1]


def chosen(incident: Incident) -> list[tuple[str, str]]:
    return [(line.what, line.text) for line in story.brief(incident, at(-10_000))]


def test_what_matters_is_seen_without_scrolling() -> None:
    made = drive_and_die()
    for ms in range(-2500, 2000, 30):
        made.event(ms, "note", f"a word at {ms}")
        made.cause(ms, causes.PIPED(f"number {ms}"))
    lines = shown(made)
    assert len(lines) < TERMINAL_LINES, "and a line for the prompt"
    assert [line for line in lines if line.startswith(">>")] == [">>         0  CAUSE       gate died"]
    assert lines[-1] == "--all tells the rest; a picture: `failstop incident plot`"


def test_the_lines_that_lead_to_it_and_come_of_it_are_in_order() -> None:
    assert chosen(drive_and_die().incident()) == [
        ("enabled", "motion enabled by nav (pid 77)"),
        ("command", "nav (pid 77) commands"),
        ("gate", "lets the wheels turn"),
        ("wheels", "the IMU says: they turn"),
        ("gate", "no tick for 2212 ms from here"),
        (CAUSE, "gate died"),
        ("wire", "STOP BURST by the port owner"),
        ("died", "! gate (pid 102) was killed by SIGKILL"),
        ("beat", "last beat of the gate for 190 ms"),
        ("wheels", "the IMU says: still"),
    ]


def test_what_was_before_a_reset_belongs_to_another_stop() -> None:
    made = drive_and_die()
    made.event(-2000, "died", "stopper (pid 103) was killed by SIGKILL", "error", process="stopper", pid=103)
    assert ("died", "! stopper (pid 103) was killed by SIGKILL") in chosen(made.incident())
    made.event(-1500, "reset", "nav (pid 77): latched stop cleared (was: stopper died); motion still disabled")
    told = chosen(made.incident())
    assert ("died", "! stopper (pid 103) was killed by SIGKILL") not in told
    assert told[0] == ("reset", "nav (pid 77): latched stop cleared")


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


def test_who_asked_for_a_stop_and_who_noticed_it_are_two() -> None:
    made = Recorder(causes.REQUESTED("hand near wheel", "failstop estop", 9))
    assert fact(made, "why") == "stop request: hand near wheel"
    assert fact(made, "noticed") == "by the port owner; asked for by failstop estop (pid 9)"


def test_a_stop_that_was_written_when_the_port_was_back() -> None:
    made = Recorder(causes.DEVICE_LOST())
    assert made.stop is not None
    made.stop |= {"written_us": 5_000_000.0, "acknowledged_us": None, "observed_ms": None}
    made.event(5003, "device_back", "/dev/ttyACM0 is back after 5.0 s; the stop is written")
    assert fact(made, "written") == "by the port owner, after 5.0 s, when the port was back"
    made.stop |= {"written_us": None, "written_by": None}
    made.beats(2200)
    assert fact(made, "written") == "NOT within the 2.2 s that are recorded after the cause"


def test_the_samples_say_still_where_the_supervisor_was_held_up() -> None:
    made = drive_and_die()
    assert made.stop is not None
    made.stop["observed_ms"] = 0.0
    assert re.fullmatch(r"by the IMU: wheels still after (less than 0\.2|about 0\.[2-4]) s", fact(made, "observed"))
    stood = Recorder(causes.KEY(1))
    assert stood.stop is not None
    stood.stop["observed_ms"] = 0.0
    assert fact(stood, "observed") == "by the IMU: no shaking seen before or after"


@pytest.mark.parametrize(("kind", "ended"), [("driver_silent", "nav fell silent"), ("driver_gone", "nav has gone")])
def test_a_driver_that_went_is_why_the_wheels_stood(kind: str, ended: str) -> None:
    made = Recorder(causes.PIPED("somebody looked"))
    made.core.enable(7, "", at(-3000))
    for ms in range(-3000, -2000, 20):
        made.core.scan.deliver(at(ms), at(ms))
        made.command(ms, (0.2, 0.0, 0.0))
        made.tick(ms)
    made.event(-1690, kind, ended, "warning", who="nav", source="cmd_vel")
    for ms in range(-2000, 0, 20):
        made.core.scan.deliver(at(ms), at(ms))
        made.tick(ms)
    assert re.fullmatch(rf"the wheels stood \(no command\), for 1\.7 s; {ended}", fact(made, "before"))


def test_a_cause_is_there_even_when_nothing_else_is() -> None:
    assert [what for what, _ in chosen(Recorder().incident())] == [CAUSE]
    assert at(0) == CAUSE_NS
