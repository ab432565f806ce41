"""Events that tell what the state does not: processes that hung, drivers that left off, the run before this one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from failstop.api import verdict
from failstop.api.events import Event
from failstop.api.why import explain
from failstop.cli import style
from failstop.cli.screen import summary
from tests.support.states import NOW_S, driving, latched, process, state, stop

DIED = {"process": "gate", "pid": 4711, "how": "was killed by SIGKILL"}
FENCED = {"process": "gate", "pid": 4711, "silent_ms": 60.3, "kill_us": 200.0}
NAV = {"who": "nav (pid 42)", "source": "cmd_vel", "silent_ms": 301.0}
BLOCKED = driving(blocked="cmd timeout", body_vel=(0.0, 0.0, 0.0), wheels_radps=(0.0,) * 4, sources=())


TEXTS = {
    "driver_silent": "nav (pid 42) stopped sending commands while it drove: last command 301 ms ago, so the wheels are "
    "told to stop",
    "driver_gone": "nav (pid 42) ended or died while it drove, so the wheels are told to stop",
}


def told(kind: str, fields: Mapping[str, Any] | None = None, t: float = NOW_S - 3, seq: int = 1) -> Event:
    return Event(seq, t, 1, kind, "warning", TEXTS.get(kind, f"{kind} happened"), dict(fields or {}))


def shown(state_: object, events: list[Event]) -> str:
    return "\n".join(style.plain(line) for line in summary.lines(state_, NOW_S, 100, events))  # type: ignore[arg-type]


def why(state_: object, events: list[Event]) -> str:
    return str(explain(state_, events, NOW_S))  # type: ignore[arg-type]


def test_a_process_that_was_fenced_hung() -> None:
    dead = state(processes={"gate": process(restarts=1, last_exit="killed by SIGKILL", killed=True)})
    fenced = [told("fenced", FENCED), told("died", DIED)]
    said = "gate was restarted once; it hung, and was killed by the supervisor"
    assert said in shown(dead, fenced)
    down = state(processes={"gate": process(pid=0, state="down", last_exit="killed by SIGKILL", killed=True)})
    assert "it hung, and was killed by the supervisor" in " ".join(shown(down, fenced).split())
    assert "it hung, and was killed by the supervisor" in why(down, fenced)


def test_a_death_after_that_one_is_a_death() -> None:
    dead = state(processes={"gate": process(restarts=2, last_exit="killed by SIGKILL", killed=True)})
    events = [told("fenced", FENCED), told("died", DIED), told("died", {**DIED, "pid": 4712})]
    assert "2 times; it was killed by SIGKILL" in shown(dead, events)
    assert "2 times; it was killed by SIGKILL" in shown(dead, [told("died", DIED)])
    crashed = state(processes={"gate": process(restarts=1, last_exit="exited with code 1")})
    assert "once; it exited with code 1" in shown(crashed, [])


def rows(state_: object, events: list[Event]) -> str:
    """The screen in one line."""
    return " ".join(shown(state_, events).split())


UNTIMED = "this stop was not timed: failstop times only latched stops"
KEY = stop(t=NOW_S - 300, noticed_ns=1)


def test_who_fell_silent_is_named_while_nobody_commands() -> None:
    events = [told("enabled", t=NOW_S - 9), told("driver_silent", NAV)]
    said = "last stop nav (pid 42) stopped sending commands while it drove: last command 301 ms"
    assert f"driver nobody commands {said}" in rows(BLOCKED, events)
    assert ", 3.0 s ago)" in shown(BLOCKED, events)
    assert "its timeout: nav (pid 42) stopped sending commands while it drove" in why(BLOCKED, events)
    assert why(BLOCKED, events).splitlines()[0].endswith(", 3.0 s ago)")


def test_who_ended_while_it_drove_is_named() -> None:
    events = [told("driver_gone", NAV)]
    found = driving(blocked="cmd timeout", sources=(), clients=())
    assert "nav (pid 42) ended or died while it drove" in shown(found, events)
    assert "nav (pid 42) ended or died while it drove" in why(found, events)


def test_whose_death_disabled_motion_is_told_whoever_commands_now() -> None:
    dead = dataclasses.replace(told("driver_gone", NAV), text="motion disabled: nav (pid 42) died after it had driven")
    for disabled in (state(blocked="disabled"), driving(blocked="disabled", enabled=False)):
        found = rows(disabled, [told("enabled"), dead])
        assert "last stop motion disabled: nav (pid 42) died after it had driven (" in found
        assert found.count("died after") == 1
        assert "ago: nav (pid 42) died after it had driven" in why(disabled, [told("enabled"), dead])
        for since in ("disabled", "stop"):
            assert "died after" not in shown(disabled, [dead, told(since)])


def test_the_last_stop_is_what_stopped_the_wheels_last_and_a_latched_one_before_it_is_earlier() -> None:
    past = [told("stop", t=NOW_S - 300), told("reset", t=NOW_S - 60), told("enabled", t=NOW_S - 50)]
    dead = dataclasses.replace(told("driver_gone", NAV), text="motion disabled: nav (pid 42) died after it had driven")
    events = [*past, dataclasses.replace(dead, ns=2)]
    for found in (state(last_stop=KEY), driving(last_stop=KEY)):
        said = rows(found, events)
        assert "last stop motion disabled: nav (pid 42) died after it had driven (" in said
        assert f"3.0 s ago) {UNTIMED} earlier a latched stop: key1 (" in said
        assert said.count("5 min ago") == 1
        assert "acknowledged" not in said, "the times of an earlier stop say nothing about this one"


def test_the_proofs_of_a_stop_are_not_shown_where_the_events_since_then_are_not_remembered() -> None:
    """The service keeps the newest events. What is missing may say that the wheels have turned since."""
    newest = dataclasses.replace(told("limit", seq=300), ns=2)
    for events in ([], [newest]):
        said = rows(state(last_stop=KEY), events)
        assert "last stop latched: key1 (" in said
        assert "the events since then are not remembered" in said
        assert "acknowledged" not in said
    assert "acknowledged" in rows(latched(last_stop=KEY), [newest]), "nothing can have moved them"
    assert "acknowledged" in rows(state(last_stop=KEY), [dataclasses.replace(newest, ns=KEY.noticed_ns)])


def test_a_latched_stop_that_came_later_is_the_last() -> None:
    ended = dataclasses.replace(told("disabled", t=NOW_S - 400), ns=0)
    for found in (state(last_stop=KEY), latched(last_stop=KEY)):
        for later in ([], [told("stop", t=NOW_S - 300), told("reset")]):
            said = rows(found, [ended, *later])
            assert "acknowledged by the board after 4.40 ms" in said
            assert UNTIMED not in said
    asked_while_latched = dataclasses.replace(told("disabled"), ns=2)
    assert "last stop the one that is latched (" in rows(latched(last_stop=KEY), [asked_while_latched])


def test_a_driver_of_before_is_no_news() -> None:
    events = [told("driver_silent", NAV), told("enabled")]
    assert "silent" not in shown(BLOCKED, events)
    assert "driver nobody commands last stop nav (pid 42)" in rows(state(), [told("driver_silent", NAV)])
    assert "silent" not in shown(driving(), [told("driver_silent", NAV)]), "somebody drives again"


def _incident(run: str, reason: str = "supervisor died") -> tuple[Event, str]:
    identity = "20260131-120000-supervisor-died"
    fields = {"id": identity, "run": run, "at": NOW_S - 60, "reason": reason}
    return told("incident", fields, NOW_S - 5, seq=4), identity


def test_the_run_before_this_one_is_told_of_with_its_incident() -> None:
    saved, identity = _incident("before")
    events = [told("ready", t=NOW_S - 8), saved]
    said = " ".join(shown(state(), events).split())
    assert f"the run before this one: supervisor died (`failstop incident show {identity}`)" in said
    assert f"(`failstop incident show {identity} --name left`)" in why(state(name="left"), events)
    assert "supervisor died" in why(state(), events)
    assert identity not in why(BLOCKED, events), "somebody has enabled motion since"


def test_an_incident_of_this_run_is_none_of_before() -> None:
    own, _ = _incident("this", "gate died")
    begun = told("ready", t=NOW_S - 8)
    assert verdict.before([begun, told("stop", t=NOW_S - 7.4, seq=2), own]) == ""
    assert verdict.before([begun, told("incident", {"reason": "no room"})]) == ""


def test_the_run_before_this_one_is_told_of_without_its_incident_where_that_could_not_be_saved() -> None:
    begun, failed = told("ready", t=NOW_S - 8), told("incident", {"run": "before", "ended": "supervisor died"})
    failed = dataclasses.replace(failed, text="incident not saved: no room on the disk")
    said = "supervisor died; its incident was not saved: no room on the disk"
    assert verdict.before([begun, failed]) == said
    assert f"the run before this one: {said}" in why(state(), [begun, failed])
    killed = dataclasses.replace(failed, fields={"run": "before"})
    assert verdict.before([killed]).startswith("it did not end cleanly; its incident was not saved")
    assert verdict.before([]) == ""
