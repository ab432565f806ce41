"""The story: in order, what repeats told once, the cause marked, and fit for a terminal of 80 columns."""

from __future__ import annotations

import json
import re
from math import nan

import pytest

from failstop.board.interface import BOARD
from failstop.incidents import report, story
from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE, Line
from failstop.policy import causes
from failstop.shm import layout
from tests.support.incident_parts import CAUSE_NS, UNIX_NS, Recorder, at, drive_and_die, printed

NOW_S = UNIX_NS / 1e9 + 7200


@pytest.fixture(scope="module")
def incident() -> Incident:
    return drive_and_die().incident()


def told(incident: Incident, what: str) -> list[str]:
    return [line.text for line in story.tell(incident) if line.what == what]


def text(incident: Incident, columns: int = 80, seconds: float = 10.0) -> str:
    return printed(report.text(incident, columns, incident.cause_ns - round(seconds * 1e9), NOW_S))


def summary(incident: Incident, columns: int = 80, seconds: float = 10.0) -> str:
    return printed(report.summary(incident, columns, incident.cause_ns - round(seconds * 1e9), NOW_S))


def test_lines_are_in_the_order_of_time_and_one_is_the_cause(incident: Incident) -> None:
    lines = story.tell(incident)
    assert [line.ns for line in lines] == sorted(line.ns for line in lines)
    assert [line.ns for line in lines if line.what == CAUSE] == [CAUSE_NS]
    assert told(incident, CAUSE) == ["gate died; noticed by the port owner"]


def test_what_repeats_is_told_once(incident: Incident) -> None:
    commands = [line for line in story.tell(incident) if line.what == "command"]
    assert [line.text for line in commands] == ["nav (pid 77) as cmd_vel: vx +0.20 m/s"] * 2
    assert [line.count for line in commands] == [125, 25], "far from the cause, and near it"
    assert len(story.tell(incident)) < 40


def test_bursts_are_told_one_by_one_near_the_cause(incident: Incident) -> None:
    bursts = [incident.ms(line.ns) for line in story.tell(incident) if line.text.startswith("STOP BURST")]
    assert bursts == pytest.approx([0.2, 20.2, 100.2])


def test_frames_before_and_after(incident: Incident) -> None:
    wire = told(incident, "wire")
    assert any(line.startswith("motion") and "+0.796 +0.796 -0.796 -0.796" in line for line in wire)
    assert "zero frames" in wire
    assert wire.count("pings, which the board answers") == 2


def test_who_went_silent_and_for_how_long(incident: Incident) -> None:
    assert told(incident, "beat") == ["last beat of the gate for 190 ms"]
    (silence,) = incident.silences()
    assert (silence.process, silence.ended) == (layout.GATE, True)
    assert (incident.ms(silence.since_ns), incident.ms(silence.until_ns)) == (9.0, 199.0)


def test_the_wheels_turn_and_then_are_still(incident: Incident) -> None:
    assert [still for _, still in incident.verdicts()] == [False, True]
    stood_ms = incident.ms(incident.verdicts()[-1][0])
    assert 80 < stood_ms < 900


def test_a_frame_that_the_port_did_not_take_is_told() -> None:
    made = Recorder()
    made.frame(-10, BOARD.motor_speeds((1, 1, -1, -1), 5.0), taken=0)
    assert told(made.incident(), "wire") == ["motion [+1.000 +1.000 -1.000 -1.000] rps; the port took 0 of 27 bytes"]


def test_a_command_that_is_not_finite_is_shown_as_it_was() -> None:
    made = Recorder(causes.NOT_FINITE("nav (pid 77)"))
    made.command(0, (nan, 0.0, 0.0))
    made.tick(1)
    assert told(made.incident(), "command") == ["nav (pid 77) as cmd_vel: vx +nan m/s"]


def test_a_board_that_falls_silent() -> None:
    made = Recorder(causes.DEAF())
    for ms in range(-2000, -500, 9):
        made.imu(ms, 0.002)
    made.beats(2000)
    lines = told(made.incident(), "board")
    assert lines[0] == "is heard"
    assert re.fullmatch(r"its last byte; silent until the end, 2\d\d\d ms", lines[1])


def test_a_request_in_the_words_of_a_death_does_not_hide_the_death() -> None:
    made = Recorder(causes.PIPED("gate died"))
    said = "STOP latched: stop request: gate died; stop frame written by the port owner after 90 us"
    made.event(0.5, "stop", said, "warning", reason="stop request: gate died", cause="piped")
    made.event(1.0, "note", "no reason here")
    made.cause(0, causes.PIPED("gate died"))
    made.cause(300, causes.DIED("gate"))
    assert told(made.incident(), "cause") == ["gate died (noticed by the port owner)"]


def test_a_death_that_was_told_of_does_not_hide_another() -> None:
    made = Recorder(causes.DIED("supervisor"))
    made.event(0.5, "stop", "STOP latched: supervisor died", "warning", reason="supervisor died", cause="died")
    made.cause(0, causes.DIED("supervisor"))
    made.cause(300, causes.DIED("gate"))
    assert told(made.incident(), "cause") == ["gate died (noticed by the port owner)"]


def test_a_stop_that_was_told_of_is_told_once_though_its_words_were_cut() -> None:
    made = Recorder()
    made.event(300, "stop_again", "stopped again", reason="stop request: x", cause="piped")
    made.cause(300, causes.PIPED("x and more"))
    assert told(made.incident(), "cause") == []


def test_an_empty_incident_is_a_report_all_the_same() -> None:
    made = Recorder()
    made.stop = None
    shown = text(made.incident())
    for fact in ("before", "noticed", "written", "acknowledged", "observed"):
        assert re.search(rf"^  {fact} +.*not known", shown, re.M), fact
    assert summary(made.incident()).startswith("Incident ")


@pytest.mark.parametrize("columns", [80, 100, 200, 10])
def test_nothing_is_wider_than_the_terminal(columns: int) -> None:
    made = drive_and_die()
    made.event(5, "note", "a word of Dr. " + "Pneumonoultramicroscopicsilicovolcanoconiosis " * 6)
    for shown in (text, summary):
        lines = shown(made.incident("20260921-143320-" + "x" * 20), columns).splitlines()
        assert max(map(len, lines)) <= max(columns, 80)


def test_the_report_reads_from_the_reason_to_the_versions(incident: Incident) -> None:
    shown = text(incident)
    parts = [
        "Incident 20260921-143320-gate-died",
        "why gate died",
        ", 2 h 0 min ago; service",
        "driving, vx +0.20 m/s; nav (pid 77) as cmd_vel",
        "noticed by the port owner",
        "written by the port owner, after 0.21 ms",
        "acknowledged by the board, after 3.10 ms",
        "observed by the IMU: wheels still after about 0.3 s",
        "recorded from",
        "Story, milliseconds from the cause",
        "motion enabled by nav",
        ">>         0  CAUSE",
        "! gate (pid 102) was killed by SIGKILL",
        "Processes, as the file was saved",
        "12.5 % of the time something waited for cpu",
        "device.path = /dev/pts/7",
        "failstop 0.1.0, python 3.11.7",
    ]
    places = [re.sub(r"\s+", " ", shown).find(re.sub(r"\s+", " ", part)) for part in parts]
    assert -1 not in places, parts[places.index(-1)]
    assert places == sorted(places)


def test_what_began_before_is_told_as_of_where_the_story_begins() -> None:
    lines = [Line(at(-5000), "wire", "a", at(-100), 3), Line(at(-5000), "wire", "b"), Line(at(5), "wire", "c")]
    shown = story.within(lines, at(-1000))
    assert [(line.text, line.ns) for line in shown] == [("a", at(-1000)), ("c", at(5))]


def test_json_has_the_whole_of_it(incident: Incident) -> None:
    found = json.loads(json.dumps(report.as_dict(incident)))
    assert found["reason"] == "gate died"
    assert found["settings"]["device.path"] == "/dev/pts/7"
    assert [row["ms"] for row in found["story"] if row["what"] == CAUSE] == [0]
    assert set(found["processes"]) == set(layout.PROCESSES)
