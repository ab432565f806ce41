"""The bench's judges: each bar is missed by what misses it, and by nothing at all having been measured."""

import dataclasses
import json
import os
import signal
import time
from pathlib import Path

import pytest

from bench import __main__ as bench_main
from bench import hangs, kills, latency, report, soak, stalls, stats
from bench.stalls import Control, Stall
from failstop.lab.trial import Stopped, wait_for
from failstop.policy import causes
from failstop.shm.heartbeat import MEMORY_LOCKED

Capture = pytest.CaptureFixture[str]
HANGS = causes.HANGS("gate", 70)
MS = 1_000_000
GOOD = Stopped(0, MS, MS, MS, 0, True)


@pytest.mark.parametrize(
    ("samples_ms", "bars", "met"),
    [
        ([1, 1], {"p50_ms": 2.0, "p99_ms": None}, True),
        ([3, 3], {"p50_ms": 2.0, "p99_ms": None}, False),
        ([1, 9], {"p50_ms": None, "p99_ms": 5.0}, False),
        ([], {"p50_ms": 2.0, "p99_ms": 5.0}, False),
        ([9], {"p50_ms": None, "p99_ms": None}, None),
    ],
)
def test_times(samples_ms: list[int], bars: dict[str, float | None], met: bool | None) -> None:
    assert stats.timing("x", [ms * MS for ms in samples_ms], **bars).met is met


@pytest.mark.parametrize(
    ("floor_ms", "met"),
    [((1.0, 1.0, 9.0), True), ((0.9, 1.0, 9.0), False), ((1.0, 0.9, 9.0), False), ((9.0, 9.0, 9.0), True)],
)
def test_times_as_multiples_of_a_floor(floor_ms: tuple[float, float, float], met: bool) -> None:
    row = stats.over_floor("x", [int(1.5 * MS)] * 49 + [int(2.0 * MS)] * 51, floor_ms, p50=2.0, p99=2.0)
    assert row.met is met


def test_counts_and_limits() -> None:
    assert [stats.count("x", found, of).met for found, of in ((0, 9), (1, 9), (0, 0))] == [True, False, False]
    assert [stats.limit("x", value, 6, "%").met for value in (5.9, 6.0)] == [True, False]


@pytest.mark.parametrize(
    ("bad", "missed"),
    [
        (Stopped(0, None, None, None, 0, True), "stops missed"),
        (Stopped(0, MS, MS, MS, 1, True), "motion frames after the stop"),
        (Stopped(0, MS, MS, MS, 0, False), "kills that found the wheels at rest"),
    ],
)
def test_a_bad_kill_misses_its_row(bad: Stopped, missed: str) -> None:
    rows = kills.rows_of([MS], [MS], {"gate": [GOOD, bad]}, "")
    assert [row.measure for row in rows if row.met is False] == [missed]
    assert not [row for row in kills.rows_of([MS], [MS], {"gate": [GOOD]}, "") if row.met is False]


def test_a_hang_that_is_noticed_late_misses_its_row() -> None:
    late_ns = round((60 + hangs.MARGIN_MS) * MS)
    assert [hangs.row_of("gate", 60.0, [ns]).met for ns in (late_ns - MS, late_ns)] == [True, False]
    assert hangs.row_of("gate", 60.0, []).met is False


def test_the_soak_s_bars() -> None:
    assert soak.tick_row(soak.Soak(), judged=True).met is False, "no ticks are not good ticks"
    false = soak.Soak(seconds=60.0, stops=[(1.0, HANGS)])
    assert (soak.stop_row(false, realtime=True).met, soak.stop_row(soak.Soak(seconds=1.0), realtime=True).met) == (
        False,
        True,
    )
    for growth_mb, met in ((0.0, True), (0.1, False)):
        times_s = [60.0 + 20 * n for n in range(5)]
        memory = [{"gate": (9 + growth_mb * n, 5 + growth_mb * n)} for n in range(5)]
        assert soak.memory_rows(soak.Soak(memory=memory, sampled_s=times_s))[1].met is met


@pytest.mark.parametrize(
    ("bad", "missed"),
    [
        (Stopped(0, None, None, None, 0, True), "stops missed after a hang"),
        (Stopped(0, MS, MS, MS, 1, True), "motion frames after it, the hung process continued"),
        (Stopped(0, MS, MS, MS, 0, False), "stops missed after a hang"),
    ],
)
def test_a_bad_hang_misses_its_row(bad: Stopped, missed: str) -> None:
    rows = hangs.rows_of({"gate": [GOOD, bad]})
    assert [row.measure for row in rows if row.met is False] == [missed]
    assert not [row for row in hangs.rows_of({"gate": [GOOD]}) if row.met is False]


@pytest.mark.parametrize(
    ("samples_ms", "met"), [([300, 320], True), ([299, 310], False), ([300, 321], False), ([], False)]
)
def test_a_deadman_that_is_too_soon_or_too_late_misses_its_row(samples_ms: list[int], met: bool) -> None:
    assert latency.timeout_row([ms * MS for ms in samples_ms]).met is met


def test_the_control_tells_what_the_machine_did_from_what_the_service_did() -> None:
    found = soak.Soak(seconds=60.0, stops=[(1.0, HANGS), (2.0, HANGS)], caused_ns=[1000 * MS, 2000 * MS])
    stood = Control([Stall(0, 920 * MS, 990 * MS, 70.0), Stall(1, 1990 * MS, 1996 * MS, 0.0)])
    _, explained = soak.stall_rows(found, stood)
    assert (explained.met, explained.numbers["stops"]) == (False, [(2.0, str(HANGS))]), "6 ms are no reason"
    assert explained.numbers["stall_ms"] == [70.0, 6.0]
    assert soak.stall_rows(soak.Soak(seconds=60.0), stood)[1].met is True
    assert soak.stop_row(found, realtime=True).met is False, "explained or not"
    died = dataclasses.replace(found, stops=[(1.0, causes.DIED("gate")), (2.0, HANGS)])
    assert soak.stall_rows(died, stood)[1].numbers["found"] == 2, "a stall kills nobody"
    for cause in (causes.STARVED("gate", 70), causes.HELD_UP(70), causes.MUTE(70), causes.SILENT()):
        silent = dataclasses.replace(found, stops=[(1.0, cause)], caused_ns=[1000 * MS])
        assert soak.stall_rows(silent, stood)[1].numbers["found"] == 0, cause
    posed = dataclasses.replace(found, stops=[(1.0, causes.PIPED(str(HANGS)))], caused_ns=[1000 * MS])
    assert soak.stall_rows(posed, stood)[1].numbers["found"] == 1, "nobody's words are a silence"


@pytest.mark.parametrize(
    ("begin_ms", "end_ms", "longest_ms"), [(0, 919, 0), (0, 920, 70), (950, 960, 70), (991, 999, 0)]
)
def test_the_longest_stall_of_a_time(begin_ms: int, end_ms: int, longest_ms: float) -> None:
    stood = Control([Stall(0, 920 * MS, 990 * MS, 70.0), Stall(1, 920 * MS, 926 * MS, 0.0)])
    assert stood.longest_ms(begin_ms * MS, end_ms * MS) == longest_ms


@pytest.mark.skipif(os.geteuid() != 0, reason="real-time scheduling is root's")
def test_a_control_that_is_held_up_says_so() -> None:
    """By what no process can resist: SIGSTOP. A core that nobody withholds has no stall of that length."""
    with stalls.control() as control:
        loops = control.pids
        begin_ns = time.monotonic_ns()
        os.kill(loops[0], signal.SIGSTOP)
        held_ns = time.monotonic_ns() + 60 * MS
        wait_for("a while", lambda: time.monotonic_ns() > held_ns)
        os.kill(loops[0], signal.SIGCONT)
        end_ns = time.monotonic_ns()
    assert control.longest_ms(begin_ns, end_ns) >= 55
    assert min(os.sched_getaffinity(0)) in {one.core for one in control.stalls if one.ms >= 55}


def test_a_control_without_real_time_priority_is_none() -> None:
    """Memory that is locked does not put it above the service."""
    assert stalls.loop(0, MEMORY_LOCKED) == 1


@pytest.mark.parametrize(("met", "code"), [(True, 0), (None, 0), (False, 1)])
def test_a_missed_bar_is_the_exit_code(met: bool | None, code: int, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "there" / "rows.json"
    rows = [stats.Row("a measure", "its result", "-" if met is None else "its bar", met, {})]
    assert report.end(rows, str(out), {"load": True}, other=[1]) == code
    said = capsys.readouterr().out
    assert "a measure\n    its result" in said
    assert ("MISSED" in said) == (met is False)
    written = json.loads(out.read_text())
    assert (written["machine"]["load"], written["other"], written["rows"][0]["met"]) == (True, [1], met)


def test_the_bench_is_there_without_its_peers() -> None:
    assert bench_main.main
