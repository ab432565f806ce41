"""The judge and the campaign say when something is wrong: they are what every other word about faults rests on."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api import distance
from failstop.policy.causes import KEY
from failstop_lab.faults import injection, report, steps
from failstop_lab.faults.fault import KILL, Fault
from failstop_lab.faults.injection import Outcome, _Injection, draw, inject_one
from failstop_lab.faults.judge import verdict
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.steps import Steps
from failstop_lab.faults.table import FAULT_BY_NAME, TABLE
from failstop_lab.trial import Service, TrialError, judge, wait_for
from tests.support.board_events import FAULT_NS, MS, STILL, TURNING, event

KILL_GATE = FAULT_BY_NAME["kill-gate"]


LIMIT_MS = KILL_GATE.limit_ms or 0.0


@pytest.mark.parametrize(
    ("times", "fault", "told"),
    [
        (((-10, True), (0.2, True), (0.5, False), (20, False)), "kill-gate", []),
        (((-10, True), (10, True)), "kill-gate", ["NO STOP"]),
        ((), "kill-gate", ["NO STOP"]),
        (((-1, False),), "kill-gate", ["NO STOP"]),  # from before the fault
        (((LIMIT_MS, False),), "kill-gate", []),
        (((LIMIT_MS + 0.1, False),), "kill-gate", ["ms, the limit is"]),
        (
            ((0.5, False), (0.6, True), (0.7, False), (0.8, True)),
            "kill-gate",
            ["2 motion frames after the stop and before any enable"],
        ),
        (((-1, False), (1, True)), "board-garbles-up", []),
        (((1, False),), "board-garbles-up", ["and nothing was to stop"]),
    ],
)
def test_the_judge_tells_a_stop_in_time_and_for_good_from_others(
    times: Sequence[tuple[float, bool]], fault: str, told: list[str]
) -> None:
    events = [event(i, ms, TURNING if moves else STILL) for i, (ms, moves) in enumerate(times)]
    found = verdict(FAULT_BY_NAME[fault], events, FAULT_NS, True)[1]
    assert len(found) == len(told)
    assert all(part in text for part, text in zip(told, found, strict=True))


def test_wheels_that_were_at_rest_prove_nothing() -> None:
    found = verdict(KILL_GATE, [event(0, 0.5, STILL)], FAULT_NS, False)[1]
    assert found == ["the wheels were not turning before the fault"]


def test_a_board_that_obeys_no_stop_is_no_error_of_the_judge() -> None:
    told = dataclasses.replace(event(0, 1.0, STILL), speeds=(0.1, 0.0, 0.0, 0.0))
    found = judge([told], FAULT_NS, True)
    assert found.stop_ns == MS
    assert found.still_ns is None
    assert judge([event(0, 1.0, TURNING)], FAULT_NS, True).motion_after == 1, "also without a stop"


def test_a_write_outside_the_motor_table() -> None:
    events = [event(0, 0.5, STILL), dataclasses.replace(event(1, 1, STILL), wild=((7, 1.0),))]
    assert verdict(KILL_GATE, events, FAULT_NS, True)[1] == ["1 writes outside the board's motor table"]


def test_what_is_counted() -> None:
    tally = report.Tally((KILL_GATE, FAULT_BY_NAME["suspended"]), seed=7)
    for events in ([event(0, 2, STILL), event(1, 3, TURNING)], [event(0, 4, STILL)], [event(0, 1, TURNING)]):
        stopped, found = verdict(KILL_GATE, events, FAULT_NS, True)
        tally.add(Outcome(KILL_GATE, 0, stopped, wrong=found, events=events))
    tally.add(Outcome(FAULT_BY_NAME["suspended"], 0, skipped="no sleep"))
    tally.add(Outcome(KILL_GATE, 0, wrong=["no service to kill"], struck=False))
    result = tally.as_dict()
    assert (result["count"], result["missed"], result["motion_after"], result["wrong"]) == (3, 1, 1, 3)
    assert result["rows"][0]["p50_ms"] == 4.0
    assert "max_ms" not in result["rows"][0]
    assert result["rows"][1]["skipped"] == "no sleep"
    assert len(result["stories"]) == 3
    assert "seed 7" in tally.stories[0]
    assert "MOTION" in tally.stories[0]
    assert "not here: no sleep" in tally.table()
    page = report.markdown(result)
    assert "1 stops missed" in page
    assert f"- {tally.stories[0].partition(chr(10))[0]}" in page.splitlines()


def with_stops(*times_ms: float, missed: int = 0) -> report.Row:
    """A row of kills with these stops."""
    return report.Row("kill-gate", len(times_ms) + missed, missed, times_ms=list(times_ms))


def test_a_percentile_is_a_time_that_was_measured_and_of_few_the_slowest() -> None:
    assert with_stops(1.0, 20.0).percentiles() == (1.0, 20.0, 20.0)
    assert with_stops(*map(float, range(100, 0, -1))).percentiles() == (50.0, 99.0, 100.0)
    assert with_stops(*map(float, range(1, 300))).percentiles() == (150.0, 297.0, 299.0)
    assert with_stops().percentiles() is None


def test_a_missed_stop_is_later_than_every_other_and_keeps_no_bar() -> None:
    """Of 100, 98 in time and a bar would be held; of these, one never came, which is the 99th."""
    for row, wanted in ((with_stops(*98 * [1.0], missed=2), {"p50_ms": 1.0}), (with_stops(missed=3), {})):
        found = row.as_dict()
        assert {name: found[name] for name in ("p50_ms", "p99_ms", "max_ms") if name in found} == wanted
        assert report.bar_held(KILL_GATE, found) is False
        tally = report.Tally((KILL_GATE,), seed=7)
        tally.rows["kill-gate"] = row
        assert "but not for kill-gate" in tally.summary()
        (line,) = (line for line in report.markdown(tally.as_dict()).splitlines() if line.startswith("| `kill-gate` "))
        assert "| missed | missed |" in line
        assert line.endswith("| **no** |")
    rare = with_stops(*200 * [1.0], missed=1).as_dict()
    assert rare["p99_ms"] == 1.0
    assert report.bar_held(KILL_GATE, rare) is False


def test_scenes_that_ended_before_their_fault_are_counted_with_their_reasons() -> None:
    tally = report.Tally((KILL_GATE,), seed=7)
    stopped, _ = verdict(KILL_GATE, [event(0, 1.0, STILL)], FAULT_NS, True)
    for again in (("it stopped by itself", "not ready"), (), ("it stopped by itself",)):
        tally.add(Outcome(KILL_GATE, 0, stopped, again=again))
    result = tally.as_dict()
    assert result["again"] == {"it stopped by itself": 2, "not ready": 1}
    assert result["rows"][0]["again"] == 3
    told = "a new one was begun: 3 (2 times: it stopped by itself; 1 times: not ready)"
    assert told in tally.summary()
    assert told in report.markdown(result)


def test_each_part_of_a_campaign_says_where_and_with_what_rights_it_ran(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine and the commit are those of its beginning, and a mixture is named."""
    results: list[dict[str, Any]] = []
    for day, kernel, realtime in (("2026-01-02", "6.1", True), ("2026-01-03", "6.2", False)):
        begun = {"version": "1", "date": day, "python": "3.11", "kernel": kernel, "machine": "x86_64", "cores": 2}
        monkeypatch.setattr(report, "facts", lambda begun=begun: begun)
        monkeypatch.setattr(report, "commit", lambda kernel=kernel: f"commit{kernel}")
        tally = report.Tally((KILL_GATE,), seed=7)
        monkeypatch.setattr(report, "commit", lambda: "a later one")
        tally.realtime = realtime
        if results:
            tally.resume(results[-1])
        tally.add(Outcome(KILL_GATE, len(results), verdict(KILL_GATE, [event(0, 1.0, STILL)], FAULT_NS, True)[0]))
        results.append(tally.as_dict())
    assert [part["commit"] for part in results[-1]["machine"]["parts"]] == ["commit6.1", "commit6.2"]
    assert results[-1]["machine"]["kernel"] == "6.1 and 6.2"
    assert results[0]["machine"]["kernel"] == "6.1"
    page = report.markdown(results[-1])
    assert "with real-time rights in 1 of 2 parts" in page
    assert (
        "Run on 2026-01-02 at commit6.1: 1 faults (2 cores, kernel 6.1, Python 3.11); "
        "2026-01-03 at commit6.2: 1 faults (2 cores, kernel 6.2, Python 3.11)." in page
    )
    assert "Run on 2026-01-02 at commit6.1: 1 faults." in report.markdown(results[0])
    results[0]["machine"]["parts"] *= 3
    assert "Run on 2026-01-02 at commit6.1: 3 faults." in report.markdown(results[0])


def test_a_bar_that_was_missed_is_marked_on_the_page_and_named() -> None:
    bar_ms = KILL_GATE.bar_ms or 0.0
    for late, mark in ((0.0, "yes"), (0.5, "**no**")):
        tally = report.Tally((KILL_GATE,), seed=7)
        for stop_ms in (1, bar_ms + late):
            stopped, _ = verdict(KILL_GATE, [event(0, stop_ms, STILL)], FAULT_NS, True)
            tally.add(Outcome(KILL_GATE, 0, stopped))
        tally.rows["kill-gate"].times_ms[0] = tally.rows["kill-gate"].times_ms[1]
        page = report.markdown(tally.as_dict())
        (row,) = (line for line in page.splitlines() if line.startswith("| `kill-gate` "))
        assert row.endswith(f"| {bar_ms:g} | {mark} |")
        found = "0 of 1 kinds of fault, but not for kill-gate" if late else "1 of 1 kinds of fault"
        assert f"**The p99 was within its bar for {found}.**" in page
        assert tally.summary().endswith(f"; the p99 was within its bar for {found}")
        assert ("MISSED" in tally.table()) is bool(late)
        assert "(processor time that the host took away)." in page


def test_the_page_marks_every_bar_that_its_numbers_missed() -> None:
    """By the text of the page alone, with nothing of what made it."""
    page = (Path(__file__).parents[3] / "docs" / "reference" / "faults.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    timed = [row for row in rows if re.fullmatch(r"[0-9.]+", row[-4]) and row[-2][0].isdigit()]
    assert len(timed) > 100
    wrong = {
        row[0]: row[-1] for row in timed if (float(row[-4]) > float(row[-2].split()[0])) is not (row[-1] == "**no**")
    }
    assert wrong == {}
    missed = sum(row[-1] == "**no**" for row in timed)
    assert f"**The p99 was within its bar for {len(timed) - missed} of {len(timed)} kinds of fault" in page


def test_the_stopping_distance_reckons_with_what_was_measured() -> None:
    found = report.last_campaign(Path(__file__).parents[3])["rows"]
    deaths = [row["p99_ms"] for row in found if re.match("(kill|crash)-[a-z_]+$", row["name"])]
    assert len(deaths) == 10
    assert max(deaths) <= 1000 * distance.DEATH_S
    for name, deadline_ms in (("hang-gate+stopper", 60), ("spin-port_owner", 100), ("hang-telemetry", 500)):
        (late_ms,) = (row["p99_ms"] - deadline_ms for row in found if row["name"] == name)
        assert late_ms <= 1000 * distance.SLACK_S


def sent_to(fault: Fault, seed: int) -> list[tuple[int, int]]:
    """The (pid, signal) of a row's steps, as this seed orders them; the pids are 100, 101 and so on."""
    sent: list[tuple[int, int]] = []
    pids = {process: 100 + number for number, process in enumerate(fault.struck(KILL))}
    Steps(fault, random.Random(seed), lambda *each: sent.append(each), lambda _: True).perform(pids, lambda _: None)
    return sent


@pytest.mark.parametrize(
    ("name", "always"), [("kill-supervisor+port_owner+stopper", True), ("kill-gate+telemetry", False)]
)
def test_what_dies_at_once_stands_still_first(name: str, always: bool) -> None:
    """Otherwise one that is killed a little later writes the stop that only the stop tool can be left to write."""
    fault = FAULT_BY_NAME[name]
    count = len(fault.steps)
    first = []
    for seed in range(20):
        sent = sent_to(fault, seed)
        assert {pid for pid, sign in sent if sign == signal.SIGKILL} == set(range(100, 100 + count))
        first.append({sign for _, sign in sent[:count]})
        assert len(sent) == (2 * count if first[-1] == {signal.SIGSTOP} else count)
    frozen = first.count({signal.SIGSTOP})
    assert frozen == 20 if always else 0 < frozen < 20


def test_processes_that_can_not_be_stopped_at_once_are_not_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    times = itertools.count(10.0, 0.03)
    monkeypatch.setattr(time, "monotonic", lambda: next(times))
    sent: list[int] = []
    fault = FAULT_BY_NAME["kill-supervisor+port_owner+stopper"]
    pids = {process: 100 + number for number, process in enumerate(fault.struck(KILL))}
    with pytest.raises(steps.NotAtOnce, match="the machine needed 30 ms to stop 3 processes at once"):
        Steps(fault, random.Random(1), lambda _, sign: sent.append(sign)).perform(pids, lambda _: None)
    assert sent == 3 * [signal.SIGSTOP] + 3 * [signal.SIGCONT]


def test_nothing_is_killed_before_every_thread_of_the_others_stands_still() -> None:
    """A signal only asks for that, and a thread that still runs writes the stop."""
    fault = FAULT_BY_NAME["kill-supervisor+port_owner+stopper"]
    looks = iter([False, True, False, True, True, True, True])
    happened: list[str] = []

    def stands(_: int) -> bool:
        happened.append("stands" if (still := next(looks)) else "runs")
        return still

    pids = {process: 100 + number for number, process in enumerate(fault.struck(KILL))}
    Steps(fault, random.Random(1), lambda _, sign: happened.append(sign.name), stands).perform(pids, lambda _: None)  # type: ignore[attr-defined]
    looked = ["runs", "stands", "runs", "stands", "stands", "stands"]
    assert happened == [*3 * ["SIGSTOP"], *looked, *3 * ["SIGKILL"]]


def test_a_process_stands_still_when_all_of_its_threads_do() -> None:
    program = "import threading, time; threading.Thread(target=time.sleep, args=(60,)).start(); print(flush=True)"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout
            child.stdout.readline()
            assert len(os.listdir(f"/proc/{child.pid}/task")) == 2
            assert not steps.stands_still(child.pid)
            child.send_signal(signal.SIGSTOP)
            wait_for("it to stand still", lambda: steps.stands_still(child.pid))
        finally:
            child.kill()
    assert steps.stands_still(child.pid), "it has ended"


def test_what_dies_one_after_the_other_has_rows_of_its_own() -> None:
    apart = FAULT_BY_NAME["kill-supervisor+port_owner+stopper-apart"]
    assert apart.stop_tool
    assert not apart.at_once


def test_a_stop_before_the_stop_tool_was_started_is_not_the_stop_tool_s() -> None:
    made = alone(tool_ns=FAULT_NS + 2 * MS, was_turning=True, board=SimpleNamespace(events=list))
    made.fault = FAULT_BY_NAME["kill-supervisor+port_owner+stopper"]
    for stop_ms, wrong in ((1.0, ["stopped 1.0 ms before the stop tool was started"]), (3.0, [])):
        made.outcome = Outcome(made.fault, 0, events=[event(0, stop_ms, STILL)])
        made._fault_ns = FAULT_NS
        made._judge()
        assert made.outcome.wrong == wrong


def test_the_board_has_its_word_about_a_stop_whatever_else_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop tool that has ended with 1 after its stop has not missed it."""

    def fails(*_: object) -> None:
        raise TrialError("the stop tool ended with exit code 1")

    def is_not_whole(_: _Injection) -> None:
        raise TrialError("the service is not whole")

    monkeypatch.setattr(_Injection, "_recover", is_not_whole)
    seen = iter([[event(0, -5.0, TURNING)], [event(1, 3.0, STILL)]])
    made = alone(
        driver=SimpleNamespace(enable=lambda: None, until=lambda *_: None, run=lambda _: None),
        chance=random.Random(1),
        service=SimpleNamespace(written=lambda: 0, pids=dict),
        trial=SimpleNamespace(turning=lambda: True),
        board=SimpleNamespace(events=lambda: next(seen)),
        tool_ns=FAULT_NS,
        wait_for_stop_tool=fails,
    )
    made.fault = FAULT_BY_NAME["kill-supervisor+port_owner+stopper"]
    made.outcome = Outcome(made.fault, 0)
    made.injector = SimpleNamespace(  # type: ignore[assignment]
        prepare=lambda _: None, strike=lambda _: FAULT_NS, during=lambda _: None, heal=lambda _: None
    )
    with pytest.raises(TrialError, match="the service is not whole"):
        made.run()
    assert made.outcome.stopped is not None
    assert made.outcome.stopped.stop_ns == 3 * MS
    assert made.outcome.wrong == ["the stop tool ended with exit code 1"]


def test_what_is_left_of_a_run_is_killed_before_the_stop_tool_comes(tmp_path: Path) -> None:
    """Also a process that the supervisor had only just started: it has the port, and no one has looked it up."""
    name = f"rest-{os.getpid()}"
    program = [sys.executable, "-c", "import time; time.sleep(60)", "stopper"]
    with contextlib.ExitStack() as ends:
        of_it, of_another = (subprocess.Popen([*program, f"name={of}"]) for of in (name, f"{name}0"))
        ends.callback(of_another.wait)
        ends.callback(of_another.kill)
        ends.callback(of_it.kill)
        service = Service(name, str(tmp_path / "board"), str(tmp_path))
        ends.callback(service.close)
        service.kill_rest()
        assert of_it.wait(5) == -signal.SIGKILL
        assert of_another.poll() is None


class Broken:
    """A scene that can't be replaced by a new one."""

    arm_spoiled = spoiled = False

    def refresh(self) -> None:
        if self.spoiled:
            raise TrialError("it is not ready")


def test_a_fault_that_went_wrong_counts_although_its_scene_can_not_be_made_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def wrong(scene: Broken, fault: Fault, index: int, *_: object) -> Outcome:
        scene.spoiled = True
        return Outcome(fault, index, judge([], FAULT_NS, True), wrong=["NO STOP"])

    monkeypatch.setattr(injection, "_inject_one", wrong)
    tally = report.Tally((KILL_GATE,), seed=7)
    outcomes = injection.campaign(Broken(), (KILL_GATE,), 7, lambda _: False)  # type: ignore[arg-type]
    tally.add(next(outcomes))
    with pytest.raises(TrialError):
        next(outcomes)
    assert (tally.count, tally.total("missed"), tally.total("wrong")) == (1, 1, 1)
    tally.end("it is not ready")
    assert tally.summary().endswith("; it could not go on: it is not ready")
    assert "- the campaign could not go on: it is not ready" in report.markdown(tally.as_dict())


def test_why_a_scene_was_begun_again_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes = [Outcome(KILL_GATE, 0, wrong=[why], struck=False) for why in ("not ready", "stopped by itself")]
    outcomes.append(Outcome(KILL_GATE, 0))
    monkeypatch.setattr(injection, "_inject_one", lambda *_: outcomes.pop(0))
    assert inject_one(Broken(), KILL_GATE).again == ("not ready", "stopped by itself")  # type: ignore[arg-type]


def test_a_seed_is_a_campaign() -> None:
    drawn = [draw(TABLE, index, 5) for index in range(200)]
    assert drawn == [draw(TABLE, index, 5) for index in range(200)]
    assert drawn != [draw(TABLE, index, 6) for index in range(200)]
    assert len({fault.name for fault in drawn}) > 50


@pytest.mark.slow
def test_a_row_that_does_not_hold_is_told_and_its_scene_is_left_nowhere(scene: Scene) -> None:
    """Rows that are not true: the campaign must say so, with what the board and the service said."""
    garbled = "NO STOP", "the wheels to stand", "blocked: disabled"
    asked = "nothing was to stop", "latched: stop request: nobody says so", "the wheels to turn again"
    lies: tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...] = (
        ("kill-gate", {"latched": ((KEY, 9),), "logged": "never said"}, ("a latch: key 9", "to say 'never said'")),
        ("board-garbles-up", {"bar_ms": 5.0, "cleared": "enable"}, garbled),
        ("stop-request", {"latched": (), "cleared": "by itself", "bar_ms": None}, asked),
    )
    before = scene.service.pids()
    for index, (name, changes, told) in enumerate(lies):
        lie = dataclasses.replace(FAULT_BY_NAME[name], **changes)
        outcome = inject_one(scene, lie, index, "lies", seen_s=0.3)
        for each in told:
            assert any(each in text for text in outcome.wrong), (each, outcome.wrong)
            assert each in outcome.story("lies")
    assert not set(before.values()) & set(scene.service.pids().values()), "a failed scene is made anew"
    assert not any(Path(f"/proc/{pid}").exists() for pid in before.values()), "and left nowhere"
    assert not inject_one(scene, KILL_GATE, 0, "and on").wrong, "the next scene is whole"


def alone(**scene: object) -> _Injection:
    """An injection of nothing into a scene made of these parts."""
    made = _Injection.__new__(_Injection)
    made._fault_ns = 0
    made.scene = SimpleNamespace(restart=lambda: None, **scene)  # type: ignore[assignment]
    made.fault, made.outcome = FAULT_BY_NAME["service-stopped"], Outcome(FAULT_BY_NAME["service-stopped"], 0)
    return made


def test_enabled_while_latched_is_told() -> None:
    made = alone(driver=SimpleNamespace(robot=SimpleNamespace(enable=lambda: None)))
    made._check_latch()
    assert made.outcome.wrong == ["enabled while latched"]


def test_a_service_that_ends_badly_is_told() -> None:
    made = alone(service=SimpleNamespace(process=SimpleNamespace(wait=lambda _: 3)))
    made._end_run()
    assert made.outcome.wrong == ["the service ended with exit code 3"]
