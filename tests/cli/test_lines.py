"""Screens as lines: every state at both widths; the live one; events."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import pytest

from failstop.api import verdict
from failstop.api.errors import FailstopError
from failstop.api.events import Event
from failstop.api.follow import Vibration
from failstop.api.snapshot import Client, Device, Imu, Source
from failstop.cli import style
from failstop.cli.commands import arm as arm_command
from failstop.cli.commands import events
from failstop.cli.commands.status import Live, spark
from failstop.cli.screen import summary
from failstop.cli.screen.terminal import CLEAR, difference
from failstop.policy import causes
from failstop.supervisor.kinds import EVENT_KINDS
from tests.support.states import NOW_S, arm, driving, latched, process, state, stop

LOST = Device("/dev/ttyACM0", "lost", "unproven")
DEAF = Device("/dev/ttyACM0", "open", "deaf")
DOWN = {
    "gate": process(
        pid=0, state="down", restarts=4, last_exit="killed by SIGKILL", killed=True, starts_in_s=41.2, age_s=1e6
    )
}
STATES = {
    "disabled": state(),
    "driving": driving(),
    "latched": latched(causes.REQUESTED("hand near the left wheel", "failstop estop", 4711)),
    "waiting for the port": latched(causes.DEVICE_LOST(), device=LOST, waiting_for="the port"),
    "deaf": latched(causes.DEAF(), device=DEAF),
    "process down": latched(causes.DIED("gate"), processes={**state().processes, **DOWN}, waiting_for="gate", age_s=9),
    "long": latched(causes.PIPED("x" * 300), clients=tuple(Client(i, "n" * 64, 4194304, False) for i in range(8))),
}


def shown(lines: list[style.Line]) -> str:
    return "\n".join(map(style.plain, lines))


@pytest.mark.parametrize("columns", [20, 80, 120])
@pytest.mark.parametrize("found", STATES.values(), ids=STATES)
def test_every_state_fits_the_width(found: Any, columns: int) -> None:
    lines = summary.lines(found, NOW_S, columns)
    table = [style.plain(line) for line in summary.processes(found)]
    assert all(style.cells(text) <= 80 for text in table)
    assert all(style.cells(style.plain(line)) <= columns for line in lines if style.plain(line) not in table)


@pytest.mark.parametrize("name", ["disabled", "driving", "latched", "deaf", "process down"])
def test_a_screen_of_24_lines_holds_it(name: str) -> None:
    assert len(summary.lines(STATES[name], NOW_S, 80)) <= 23


def test_what_the_screen_says() -> None:
    said = shown(summary.lines(STATES["latched"], NOW_S, 120))
    for part in (
        "wheels    STOPPED  stop latched: stop request: hand near the left wheel (says it is failstop estop, pid 4711)",
        "next      `failstop reset`, then `failstop enable`",
        "written by the port owner after 0.21 ms, acknowledged by the board after 4.40 ms, wheels still after about",
        "/dev/ttyACM0 open, link alive",
        "12.00 V",
        "supervisor  4711  running  5 ms  20 ms         0  realtime locked",
    ):
        assert part in said
    said = shown(summary.lines(STATES["process down"], NOW_S, 120))
    assert "gate           -  down" in said
    assert "gate died too often and is down, after it was killed by SIGKILL; it starts again in 41 s" in said
    assert "said nothing for 9.0 s" in said
    said = shown(summary.lines(STATES["waiting for the port"], NOW_S, 120))
    assert "wheels    MAY TURN" in said
    both = driving(sources=(*driving().sources, Source("x", -1, "y", "waits")))
    said = shown(summary.lines(both, NOW_S, 120))
    assert "driver    nav (pid 42)" in said
    assert "waits     y as x, priority -1" in said


def test_proofs_that_are_missing_are_seen() -> None:
    unseen = stop(causes.KEY(1), acknowledged_s=None, observed_s=None)
    assert "written by the port owner after 0.21 ms, NOT acknowledged by the board, NOT seen still by the IMU" in shown(
        summary.last_stop(latched(last_stop=unseen), NOW_S)
    )
    held = latched(last_stop=stop(sent=False, acknowledged_s=None))
    assert "NOT sent: the board accepts no bytes, NOT acknowledged" in shown(summary.last_stop(held, NOW_S))
    unwritten = latched(last_stop=stop(written_s=None))
    assert "could NOT be written" in shown(summary.last_stop(unwritten, NOW_S))


def test_restarts_and_missing_rights_are_remarked() -> None:
    again = process(restarts=2, last_exit="killed by SIGKILL", killed=True, realtime=False, memory_locked=False)
    said = shown(summary.lines(state(processes={"gate": again}), NOW_S, 120))
    assert "gate was restarted 2 times; it was killed by SIGKILL" in said
    assert "without real-time rights" in said
    assert "none" in said
    assert "this kernel reports deaths late" not in said
    late = process(early_news=False)
    assert "this kernel reports deaths late" in shown(summary.lines(state(processes={"gate": late}), NOW_S, 120))


def _live(rows: int = 40, columns: int = 100) -> tuple[Live, list[style.Line]]:
    found = Live("failstop")
    lines: list[style.Line] = []
    for tick in range(30):
        moving = tick >= 15
        rate = [0.01 * (-1) ** tick if moving else 0.0001 * (-1) ** tick, 0.0, 0.0]
        given = (driving if moving else state)(
            imu=Imu(tick * 100_000_000, (0.0, 0.0, 9.8), (*rate[:2], tick * 1e-6), 1e-6)
        )
        lines = found.lines(given, tick * 0.1, NOW_S, columns, rows)
    return found, lines


def test_the_live_screen_has_its_history() -> None:
    _, lines = _live()
    speed, turn, shake = (style.plain(line) for line in lines[3:6])
    assert speed.endswith("▁" * 15 + "█" * 15)
    assert turn.endswith("▁" * 30)
    assert "rad/s" in shake
    assert shake.rstrip()[-1] in "▆▇█"
    assert "0.20 m/s" in speed


@pytest.mark.parametrize("rows", [2, 5, 10, 24, 60])
def test_the_live_screen_fits_any_window(rows: int) -> None:
    _, lines = _live(rows, 40)
    lines = style.fit(lines, rows)
    assert len(lines) <= rows
    assert all(style.cells(style.plain(line)) <= 80 for line in lines)


def test_a_silent_imu_is_not_still() -> None:
    found = Vibration()
    assert [found.add([0.0, 0.0, 0.0]) for _ in range(20)] == [None] * 20
    assert found.add(None) is None


def samples(count: int, every_s: float = 0.1) -> list[Imu]:
    """Of a robot that shakes a bit."""
    return [Imu(round(n * every_s * 1e9), (0.0, 0.0, 9.8), (0.001 * (n % 3), 0.0, 0.0)) for n in range(1, count + 1)]


@pytest.mark.parametrize("every_s", [0.1, 0.25])
def test_the_vibration_is_known_however_often_somebody_looks(every_s: float) -> None:
    """Also of an IMU that reports more rarely than somebody looks, and that is not silent for it."""
    found = Vibration()
    for sample in samples(30, every_s):
        looks = [found.update(sample, sample.t_ns / 1e9 + later_s) for later_s in (0.0, 0.001, every_s / 2)]
    assert looks[0]
    assert looks[1:] == looks[:1] * 2


def test_an_imu_that_reports_no_more_or_repeats_itself_is_silent() -> None:
    for silent in (lambda n: samples(20)[-1], lambda n: samples(20)[-1]._replace(t_ns=n * 10**8), lambda n: None):
        found = Vibration()
        for n, sample in enumerate(samples(20), 1):
            shakes = found.update(sample, n / 10)
        assert shakes
        for n in range(21, 32):
            shakes = found.update(silent(n), n / 10)
        assert shakes is None


def test_a_service_that_has_gone_is_said_with_what_to_do(installed: Callable[[str], None]) -> None:
    found, _ = _live()
    said = shown(found.gone("no service named 'failstop' is running", 80))
    for part in ("NO SERVICE", "waiting for it to come back", "`failstop stop`", "`failstop run`"):
        assert part in said
    assert "journalctl" not in said
    installed("failstop.service")
    said = shown(found.gone("no service named 'failstop' is running", 80))
    assert "`journalctl -u failstop -e`" in said
    assert "`sudo systemctl start failstop`" in said


def test_only_changed_lines_are_written() -> None:
    first = ["one", "two", "three"]
    assert difference(None, first).startswith(CLEAR)
    assert difference(first, first) == ""
    assert difference(first, ["one", "2", "three"]) == "\x1b[2;1H2\x1b[K"
    assert difference(["one", "2", "three"], ["one"]) == "\x1b[2;1H\x1b[J"
    assert difference(None, ["one"]) == f"{CLEAR}\x1b[1;1Hone\x1b[K"


def test_sparklines() -> None:
    assert spark([0.0, 0.5, 1.0, 2.0, None], 1.0, 7) == "  ▁▅██ "
    assert spark([1.0, 0.0], 1.0, 1) == "▁"


def _event(text: str = "STOP latched: key1", kind: str = "stop") -> Event:
    return Event(7, NOW_S + 0.25, 1, kind, "warning", text, {})


def test_an_event_is_a_line() -> None:
    clock = time.strftime("%H:%M:%S", time.localtime(NOW_S))
    kind = "stop".ljust(summary.KIND_COLUMNS)
    assert style.plain(summary.event(_event(), NOW_S)) == f"{clock}.250  {kind}  STOP latched: key1"
    rows = events.rows(_event("word " * 40), NOW_S, 60)
    assert len(rows) > 3
    assert all(style.cells(style.plain(row)) <= 60 for row in rows)
    assert style.plain(rows[1]).startswith(" " * (16 + summary.KIND_COLUMNS) + "word")
    assert len(events.rows(_event("word " * 40), NOW_S, None)) == 1
    command = "`failstop incident show 20261121`"
    rows = events.rows(_event(f"incident 20261121 saved; next: {command}"), NOW_S, 80)
    assert [command in style.plain(row) for row in rows] == [False, True]


def test_every_kind_fits_its_column_and_every_level_has_a_role() -> None:
    assert {kind.level for kind in EVENT_KINDS} <= set(summary.LEVEL_STYLES)
    assert events.kinds("stop, died") == {"stop", "died"}
    with pytest.raises(FailstopError, match="no events have the kind foo"):
        events.kinds("stop,foo")


@pytest.mark.parametrize(("text", "age_s"), [("30s", 30), ("10m", 600), ("1.5h", 5400), ("1d", 86400), ("5min", 300)])
def test_since_an_age(text: str, age_s: float) -> None:
    assert events.since(text, 10**15) == 10**15 - age_s * 10**9


@pytest.mark.parametrize("text", ["", "m", "10", "10y", "-5m", "25:00", "1.2.3s", "yesterday", "14:03", "٣m"])
def test_since_nonsense(text: str) -> None:
    with pytest.raises(FailstopError, match="give an age"):
        events.since(text, 10**15)


def test_the_word_is_on_the_live_screen_too() -> None:
    _, lines = _live()
    assert verdict.DRIVING in shown(lines)


@pytest.mark.parametrize("text", ["a ` alone", "`", "two `ones` and one `", "`failstop reset`, then", ""])
def test_no_text_is_changed_by_its_backquotes(text: str) -> None:
    assert style.plain(summary.commands(text)) == text


def test_the_last_events_fill_the_rows_that_are_free() -> None:
    told_ = [Event(at, NOW_S - 9 + at, 0, "enabled", "notice", f"number {at}", {}) for at in range(1, 6)]
    tall = Live("failstop").lines(state(), 0.0, NOW_S, 100, 60, told_)
    assert [style.plain(line).split()[-1] for line in tall[-5:]] == ["1", "2", "3", "4", "5"]
    plain = [style.plain(line) for line in tall]
    assert plain[1].startswith("wheels    STOPPED"), "the headline is first"
    short = Live("failstop").lines(state(), 0.0, NOW_S, 100, len(tall) - 3, told_)
    assert [style.plain(line).split()[-1] for line in short[-2:]] == ["4", "5"], "the newest"
    none = Live("failstop").lines(state(), 0.0, NOW_S, 100, len(tall) - 6, told_)
    assert "last events" not in "".join(style.plain(line) for line in none)


def test_a_row_of_an_event_leaves_out_what_to_do_next() -> None:
    """The step stands at the top of the screen; at the end of a row it would be cut."""
    step = "`failstop reset`"
    event = Event(1, NOW_S, 1, "stop", "warning", f"STOP latched: gate died; next: {step}", {}, step)
    rows = Live("failstop").lines(state(), 0.0, NOW_S, 200, 60, [event])
    assert style.plain(rows[-1]).endswith("STOP latched: gate died")


@pytest.mark.parametrize(
    ("base", "wrist", "told"),
    [
        (True, True, "holding"),
        (True, None, "holding"),
        (True, False, "holding, except for wrist"),
        (False, False, "its torque is off"),
        (None, False, "its torque is off"),
        (None, None, "not moving; its torque has not been read yet"),
    ],
)
def test_an_arm_is_said_to_hold_by_what_its_joints_tell(base: bool | None, wrist: bool | None, told: str) -> None:
    joints = arm("base", "wrist").joints
    torques = {"base": base, "wrist": wrist}
    found = {name: dataclasses.replace(joint, torque=torques[name]) for name, joint in joints.items()}
    assert summary.arm_headline(arm(joints=found)) == told
    shown = "\n".join(style.plain(line) for line in arm_command._lines(arm(joints=found)))
    assert [row.split()[-3] for row in shown.splitlines()[-2:]] == [
        {True: "on,", False: "off,", None: "read,"}[torque] for torque in (base, wrist)
    ]


def test_servos_are_a_row_where_the_board_tells_of_them() -> None:
    servos = {"left wheel (servo 7)": (0.1, 31), "joint elbow (servo 3)": (-0.41, 30)}
    said = shown(summary.lines(state(servos=servos), NOW_S, 160))
    assert "servos    left wheel (servo 7) at 31 C is the hottest, joint elbow (servo 3) bears the most, 41%" in said
    assert "servos" not in shown(summary.lines(state(), NOW_S, 160))
    still = shown(summary.lines(state(servos={"left wheel (servo 7)": (0.0, 31)}), NOW_S, 160))
    assert "bears" not in still


@pytest.mark.parametrize(
    ("wall_s", "monotonic_s", "says"),
    [
        (60.0, 60.0, ""),
        (86_430.0, 86_400.0, ""),
        (-86_400.0, 3600.0, "-- the clock was set back by 25 h 0 min --"),
        (30_000.0, 1.0, "-- the clock went forward by 8 h 19 min (it was set, or the machine slept) --"),
    ],
)
def test_a_clock_that_jumped_between_two_events_is_said(wall_s: float, monotonic_s: float, says: str) -> None:
    earlier = Event(1, NOW_S, 10**12, "ready", "notice", "ready", {})
    later = dataclasses.replace(earlier, seq=2, t=NOW_S + wall_s, ns=10**12 + round(monotonic_s * 1e9))
    assert shown(events.clock(earlier, later)) == says
