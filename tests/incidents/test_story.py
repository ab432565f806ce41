"""The story, told once and in order, and its summary: it fits a terminal of 80 columns, and of 24 lines."""

from __future__ import annotations

import json
import re
from math import nan

import pytest

from failstop.board.rrc.board import BOARD
from failstop.cli.screen import incident as screen
from failstop.incidents import story
from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE
from failstop.messages import box, layout
from failstop.policy import causes
from failstop.policy.causes import Cause
from tests.support.incident_parts import CAUSE_NS, UNIX_NS, Recorder, at, drive_and_die, printed

NOW_S = UNIX_NS / 1e9 + 7200


@pytest.fixture(scope="module")
def incident() -> Incident:
    made = drive_and_die()
    for ms, millivolts in ((-2000, 12_100), (-1000, 11_200), (1000, 11_800)):
        made.ring(layout.TELEMETRY, "box").put(box.pack_board(box.BATTERY_KIND, millivolts, 2), at(ms))
    return made.incident()


def told(incident: Incident, what: str) -> list[str]:
    return [line.text for line in story.whole(incident) if line.what == what]


def text(incident: Incident, columns: int = 80, *, whole: bool = True) -> str:
    return printed(screen.text(incident, columns, NOW_S, whole=whole))


def test_lines_are_in_the_order_of_time_and_one_is_the_cause(incident: Incident) -> None:
    lines = story.whole(incident)
    assert [line.ns for line in lines] == sorted(line.ns for line in lines)
    assert [line.ns for line in lines if line.what == CAUSE] == [CAUSE_NS]
    assert told(incident, CAUSE) == ["gate died"]


def test_what_repeats_is_told_once(incident: Incident) -> None:
    commands = [line for line in story.whole(incident) if line.what == "command"]
    assert [line.text for line in commands] == ["nav (pid 77) as cmd_vel: 0.20 m/s forward"]
    assert [line.count for line in commands] == [150]
    assert len(story.whole(incident)) < 20


def test_bursts_from_the_first_to_the_last(incident: Incident) -> None:
    (line,) = (line for line in story.whole(incident) if line.text == "STOP BURST by the port owner")
    assert (incident.ms(line.ns), incident.ms(line.until_ns), line.count) == (0.2, 100.2, 3)


def test_what_came_before_the_cause_and_what_after_it_are_two_lines() -> None:
    made = drive_and_die()
    made.burst(-2000)
    for ms in (700, 720):
        made.core.scan.deliver(at(ms), at(ms))
        made.command(ms, (0.3, 0.0, 0.0))
        made.tick(ms)
    found = made.incident()
    lines = [line for line in story.whole(found) if line.what == "command" or line.text.startswith("STOP BURST")]
    assert [(line.what, found.ms(line.ns), line.count) for line in lines] == [
        ("command", -2999.0, 150),
        ("wire", -2000.0, 1),
        ("wire", 0.2, 3),
        ("command", 700.0, 2),
    ]
    assert lines[-1].text == "nav (pid 77) as cmd_vel: 0.30 m/s forward"


def test_frames_before_and_after(incident: Incident) -> None:
    wire = told(incident, "wire")
    assert any(line.startswith("motion") and "+0.796 +0.796 -0.796 -0.796" in line for line in wire)
    assert "zero frames" in wire
    assert wire.count("pings, which the board answers") == 2


def test_who_went_silent_and_for_how_long(incident: Incident) -> None:
    assert told(incident, "beat") == ["last beat of the gate for 190 ms"]
    ((process, since_ns, until_ns),) = incident.silences()
    assert (process, incident.ms(since_ns), incident.ms(until_ns)) == (layout.GATE, 9.0, 199.0)


def test_a_frame_that_the_port_did_not_take_is_told() -> None:
    made = Recorder()
    made.frame(-10, BOARD.motor_speeds((1, 1, -1, -1), 5.0), taken=0)
    assert told(made.incident(), "wire") == ["motion [+1.000 +1.000 -1.000 -1.000] rps; the port took 0 of 27 bytes"]


def test_a_command_that_is_not_finite_is_shown_as_it_was() -> None:
    made = Recorder(causes.NOT_FINITE("nav (pid 77)"))
    made.command(0, (nan, 0.0, 0.0))
    made.tick(1)
    assert told(made.incident(), "command") == ["nav (pid 77) as cmd_vel: nan m/s forward"]


def test_a_board_that_falls_silent() -> None:
    made = Recorder(causes.DEAF())
    for ms in range(-2000, -500, 9):
        made.imu(ms, 0.002)
    made.beats(2000)
    (line,) = told(made.incident(), "board")
    assert re.fullmatch(r"silent for 2\d\d\d ms from here", line)


@pytest.mark.parametrize("lost", [True, False])
def test_what_a_full_ring_has_lost_is_no_silence_of_the_board(lost: bool) -> None:
    """The port owner kept bytes while no telemetry ran; telemetry's ring has the newest of a long run."""
    made = Recorder(causes.DIED("gate"))
    made.ring(layout.PORT_OWNER, "received").put(b"early", at(-26_000))
    heard = made.ring(layout.TELEMETRY, "received")
    for ms in range(-2000, 500, 9):
        heard.put(b"x", at(ms))
    if lost:
        for entry in heard.entries:
            entry[0] += 600
    made.beats(500)
    said = told(made.incident(), "board")
    assert said == ([] if lost else ["silent for 24000 ms from here"])


def test_causes_that_nobody_was_there_to_tell_of() -> None:
    made = Recorder(causes.DIED("supervisor"), kind="left")
    made.event(-900, "stop", "STOP latched: key1", "warning", reason="key1", cause="key")
    made.cause(-900, causes.KEY(1))
    made.cause(0, causes.DIED("supervisor"))
    made.cause(300, causes.DIED("stopper"))
    made.stop = {"written_by": "port owner", "written_us": 30.0}
    assert told(made.incident(), "cause") == ["stopper died (noticed by the port owner)"]
    assert re.search("^  noticed +by the port owner$", text(made.incident()), re.M), "that of the stop is a fact"
    made.kind = "stop"
    assert told(made.incident(), "cause") == [], "the supervisor tells of each"


def test_an_empty_incident_is_a_report_all_the_same() -> None:
    made = Recorder()
    made.stop = None
    shown = text(made.incident())
    for fact in ("before", "noticed", "proof"):
        assert re.search(rf"^  {fact} +.*not known", shown, re.M), fact
    assert shown.count("not known") == 7
    assert text(made.incident(), whole=False).startswith("Incident ")


@pytest.mark.parametrize("columns", [80, 100, 200, 10])
def test_nothing_is_wider_than_the_terminal(columns: int) -> None:
    made = drive_and_die()
    made.event(5, "note", "a word of Dr. " + "Pneumonoultramicroscopicsilicovolcanoconiosis " * 6)
    for whole in (True, False):
        lines = text(made.incident("20260921-143320-" + "x" * 20), columns, whole=whole).splitlines()
        assert max(map(len, lines)) <= max(columns, 80)


def test_the_report_reads_from_the_reason_to_the_versions(incident: Incident) -> None:
    shown = text(incident)
    parts = [
        *("Incident 20260921-143320-gate-died", "why gate died", ", 2 h 0 min ago; service"),
        *("driving, 0.20 m/s forward; nav (pid 77) as cmd_vel", "noticed by the port owner"),
        *("proof written after 0.21 ms", "acknowledged after 3.10 ms", "still after about 0.3 s"),
        *("Story, in ms from the cause", "motion enabled by nav", ">>         0  CAUSE"),
        *("! gate (pid 102) was killed by SIGKILL", "battery 11.80 V, read"),
        *("after the cause; lowest 11.20 V", "readings age of the newest one at the cause: IMU"),
        *("load 0.50 0.40 0.30", "device.path = /dev/pts/7", "failstop 0.1.0, python 3.11.7"),
    ]
    places = [re.sub(r"\s+", " ", shown).find(re.sub(r"\s+", " ", part)) for part in parts]
    assert -1 not in places, parts[places.index(-1)]
    assert places == sorted(places)


def test_json_has_the_whole_of_it(incident: Incident) -> None:
    found = json.loads(json.dumps(story.as_dict(incident)))
    assert found["reason"] == "gate died"
    assert found["settings"]["device.path"] == "/dev/pts/7"
    assert [row["ms"] for row in found["story"] if row["what"] == CAUSE] == [0]
    assert found["machine"] == incident.machine


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
        (causes.FLEET("smoke in hall 2", "ann"), "stop request: smoke in hall 2 (says it is the fleet, for ann)"),
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
    assert fact(made, "noticed") == "by the port owner; the program says it is failstop estop (pid 9)"


def driven(since_ms: int) -> Recorder:
    """A robot that teleop drives; at -40 ms nav sends too, right after it."""
    made = Recorder(settings={"sources.teleop.priority": 90, "sources.teleop.timeout_s": 0.5, "scan.gate": "off"})
    made.core.enable(7, "", at(-3000))
    for ms in (since_ms, -40):
        made.command(ms - 1, (0.2, 0.0, 0.0), "teleop (pid 5)", "teleop", 2)
        if ms == -40:
            made.command(ms, (0.1, 0.0, 0.0))
        made.tick(ms)
    made.tick(-20)
    return made


def test_the_driver_is_named_though_another_program_sent_the_newest_command() -> None:
    made = driven(-420)
    assert not made.incident().ticks[-1].drives
    assert fact(made, "before").endswith("forward; teleop (pid 5) as teleop, command 41 ms old")


@pytest.mark.parametrize(
    ("ms", "said"),
    [
        (-420, "; teleop (pid 5) as teleop, command 421 ms old"),
        (-620, "; not for nav (pid 77) as cmd_vel, which sent the newest command"),
    ],
)
def test_the_driver_of_a_file_that_has_only_the_newest_command_of_each_tick(ms: int, said: str) -> None:
    made = driven(ms)
    ring = made.ring(layout.GATE, "box")
    ring.entries = [entry for entry in ring.entries if entry[1] != at(-40)]
    assert fact(made, "before").endswith(said)


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
    assert fact(made, "before") == "zero was commanded (no command), for 1.7 s"


def test_a_cause_is_there_even_when_nothing_else_is() -> None:
    assert [what for what, _ in chosen(Recorder().incident())] == [CAUSE]


def rolled(*speeds: tuple[float, float]) -> Incident:
    made = drive_and_die()
    for ms, rps in speeds:
        made.wheels(ms, rps, -rps, rps, -rps)
    made.wheels(speeds[-1][0], nan, nan)
    return made.incident()


def test_what_the_board_reports_of_the_wheels_is_told_beside_what_they_were_told() -> None:
    found = rolled((-40, 0.8), (-20, 0.8), (20, 0.5), (40, 0.0), (60, 0.0))
    lines = [line for line in story.whole(found) if line.what == "wheels"]
    assert [(line.text, found.ms(line.ns), line.count) for line in lines] == [
        ("seen turning, max 0.80 turns/s", -40.0, 3),
        ("seen still", 40.0, 2),
    ]
    said = "seen turning until 20 ms after the cause, seen still 40 ms after it (by the board's reports)"
    assert f"wheels    turned, at most 0.80 turns/s; {said}" in text(found, 160)


def test_readings_have_ages(incident: Incident) -> None:
    old = rolled((-20_000, 0.8))
    assert story.as_dict(old)["ages"]["wheels_s"] == 20.0
    shown = text(old, 160)
    assert "wheels    turned, at most 0.80 turns/s, 20 s before; TURNED at the last report, 20.0 s before it" in shown
    assert "readings  age of the newest one at the cause: wheels 20.0 s" in shown
    assert "were still, 20 s before" in text(rolled((-20_000, 0.0)), 160)
    assert "battery   11.80 V, read 1.0 s after the cause; lowest 11.20 V" in text(incident, 160)
    ages = story.as_dict(incident)["ages"]
    assert (ages["battery_s"], ages["wheels_s"], ages["servos_s"]) == (1.0, None, None)


def test_wheels_that_turn_at_the_end_are_told_with_their_speed() -> None:
    found = rolled((-40, 0.0), (20, 0.0), (40, 0.8), (2000, 0.81))
    said = "were still; TURNED at the last report, 2.0 s after it: at most 0.81 turns/s (by the board's reports)"
    assert f"wheels    {said}" in text(found, 160)
    assert ("wheels", "seen turning, max 0.81 turns/s") in [(line.what, line.text) for line in story.brief(found)]


def test_where_nothing_reports_the_wheels_no_line_says_what_they_did(incident: Incident) -> None:
    assert told(incident, "wheels") == []
    assert "wheels    " not in text(incident, 160)
    assert "the wheels stood" not in text(incident, 160)


def test_a_gap_in_the_reports_is_a_gap_in_the_story() -> None:
    """Telemetry was dead: nothing says when the wheels stopped, and no line is drawn or told across."""
    reports = [(ms, 0.8) for ms in range(-400, 0, 50)] + [(ms, 0.0) for ms in range(340, 700, 50)]
    found = rolled(*reports)
    lines = [line for line in story.brief(found) if line.what == "wheels"]
    assert [(line.text, found.ms(line.ns), found.ms(line.until_ns)) for line in lines] == [
        ("seen turning, max 0.80 turns/s", -400.0, -50.0),
        ("no report for 390 ms from here", -50.0, 340.0),
        ("seen still", 340.0, 690.0),
    ]
    said = "seen turning until 50 ms before the cause, seen still 340 ms after it, no report between"
    assert f"turned, at most 0.80 turns/s; {said} (by the board's reports)" in text(found, 200)


def test_reports_that_turn_before_a_gap_and_after_it_are_two_lines() -> None:
    reports = [*range(-400, 0, 50), *range(340, 700, 50)]
    lines = [line for line in story.whole(rolled(*((ms, 0.8) for ms in reports))) if line.what == "wheels"]
    assert [line.text.partition(",")[0] for line in lines] == [
        "seen turning",
        "no report for 390 ms from here",
        "seen turning",
    ]


def test_a_board_that_reports_seldom_has_no_gaps() -> None:
    found = rolled(*((ms, 0.8) for ms in range(-3000, 0, 300)), *((ms, 0.0) for ms in range(0, 2000, 300)))
    assert [line.text for line in story.whole(found) if line.what == "wheels"] == [
        "seen turning, max 0.80 turns/s",
        "seen still",
    ]


def test_what_pauses_is_told_twice() -> None:
    """Two drives, and the stops of two drives, are not one that lasted all the time."""
    made = drive_and_die()
    for ms in range(-30_000, -29_000, 20):
        made.frame(ms, BOARD.motor_speeds((1, 1, -1, -1), 5.0))
    for ms in (-29_000, -28_900, -20_000):
        made.burst(ms)
    found = made.incident()
    lines = [line for line in story.whole(found) if line.what == "wire" and line.ns < CAUSE_NS]
    spans = [(line.text.partition(" ")[0], found.ms(line.ns), found.ms(line.until_ns), line.count) for line in lines]
    assert [span for span in spans if span[0] in ("motion", "STOP")] == [
        ("motion", -30_000.0, -29_020.0, 50),
        ("STOP", -29_000.0, -28_900.0, 2),
        ("STOP", -20_000.0, -20_000.0, 1),
        ("motion", -2998.9, -18.9, 150),
    ]


def test_a_stop_ends_a_drive_however_soon_the_next_one_begins() -> None:
    made = Recorder()
    for begin_ms in (-1000, -800):
        for ms in range(begin_ms, begin_ms + 100, 20):
            made.frame(ms, BOARD.motor_speeds((1, 1, -1, -1), 5.0))
        made.burst(begin_ms + 100)
    lines = [(line.text.partition(" ")[0], line.count) for line in story.whole(made.incident()) if line.what == "wire"]
    assert lines == [("motion", 5), ("STOP", 1), ("motion", 5), ("STOP", 1)]


def test_two_drives_of_one_program_are_two_lines() -> None:
    made = drive_and_die()
    for ms in range(1500, 1600, 20):
        made.command(ms, (0.3, 0.0, 0.0))
        made.tick(ms)
    for ms in range(4000, 4100, 20):
        made.command(ms, (0.3, 0.0, 0.0))
        made.tick(ms)
    lines = [line for line in story.whole(made.incident()) if line.what == "command"]
    assert [line.count for line in lines] == [150, 5, 5]


def test_who_enabled_and_who_drove_are_never_crowded_out() -> None:
    made = drive_and_die()
    for ms in range(-2500, 2000, 30):
        made.event(ms, "note", f"a word at {ms}")
    told = chosen(made.incident())
    assert ("enabled", "motion enabled by nav (pid 77)") in told
    assert ("command", "nav (pid 77) as cmd_vel: 0.20 m/s forward") in told
    assert len(told) == story.MOST_LINES


def test_what_ends_with_the_supervisor_did_not_die_of_itself() -> None:
    made = Recorder(causes.DIED("supervisor"), kind="left")
    for process in ("gate", "telemetry", "port_owner"):
        made.cause(17, causes.DIED(process))
    assert told(made.incident(), "cause") == [
        "gate ended with the supervisor, by design (noticed by the port owner)",
        "telemetry ended with the supervisor, by design (noticed by the port owner)",
        "port_owner died (noticed by the port owner)",
    ]


@pytest.mark.parametrize(("process", "late"), [("gate", False), ("telemetry", True)])
def test_what_was_heard_only_once_telemetry_was_back(process: str, late: bool) -> None:
    made = Recorder(causes.DIED(process))
    lines = text(made.incident(), 160)
    assert ("acknowledged after 3.10 ms (heard once telemetry was back)" in lines) == late
    assert ("still after about 0.3 s (heard once telemetry was back)" in lines) == late


@pytest.mark.parametrize(("first_ms", "said"), [(0.21, ""), (0.05, " (its first bytes after 50 us)")])
def test_the_head_and_the_story_agree_when_the_stop_was_written(first_ms: float, said: str) -> None:
    made = Recorder()
    made.burst(first_ms)
    assert fact(made, "proof") == f"written after 0.21 ms{said}"
