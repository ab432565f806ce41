"""The bench's judges: each bar is missed by what misses it, and by nothing at all having been measured."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from bench import __main__ as bench_main
from bench import arm_kills, hangs, kills, latency, pages, report, soak, stalls, stats
from bench.arm_stream import PERIOD_NS, Hops
from bench.stalls import Control, Stall
from failstop.board.rrc.servos import bus_servo_move
from failstop.policy import causes
from failstop.shm.heartbeat import MEMORY_LOCKED
from failstop_lab.faults.arm import Rested
from failstop_lab.faults.arm_table import ROWS
from failstop_lab.trial import Stopped, wait_for

Capture = pytest.CaptureFixture[str]
HANGS = causes.HANGS("gate", 70)
MS = 1_000_000
GOOD = Stopped(0, MS, MS, MS, 0, True)
AFTER_IT = "motion frames after it, the hung process continued"


def missed(rows: list[stats.Row]) -> list[str]:
    return [row.measure for row in rows if row.met is False]


@pytest.mark.parametrize(
    ("samples_ms", "p50_ms", "p99_ms", "met"),
    [
        *(([1, 1], 2.0, None, True), ([3, 3], 2.0, None, False), ([1, 9], None, 5.0, False)),
        *(([], 2.0, 5.0, False), ([9], None, None, None)),
    ],
)
def test_times(samples_ms: list[int], p50_ms: float | None, p99_ms: float | None, met: bool | None) -> None:
    assert stats.timing("x", [ms * MS for ms in samples_ms], p50_ms=p50_ms, p99_ms=p99_ms).met is met


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
    ("bad", "of_a_kill", "of_a_hang"),
    [
        (Stopped(0, None, None, None, 0, True), "stops missed", "stops missed after a hang"),
        (Stopped(0, MS, MS, MS, 1, True), "motion frames after the stop", AFTER_IT),
        (Stopped(0, MS, MS, MS, 0, False), "kills that found the wheels at rest", "stops missed after a hang"),
    ],
)
def test_a_bad_kill_or_hang_misses_its_row(bad: Stopped, of_a_kill: str, of_a_hang: str) -> None:
    for stops, kill, hang in (([GOOD], [], []), ([GOOD, bad], [of_a_kill], [of_a_hang])):
        assert missed(kills.rows_of([MS], [MS], {"gate": stops}, "")) == kill
        assert missed(hangs.rows_of({"gate": stops})) == hang


def test_a_hang_that_is_noticed_late_misses_its_row() -> None:
    late_ns = round((60 + hangs.MARGIN_MS) * MS)
    assert [hangs.row_of("gate", 60.0, [ns]).met for ns in (late_ns - MS, late_ns)] == [True, False]
    assert hangs.row_of("gate", 60.0, []).met is False


def test_the_soak_s_bars() -> None:
    assert soak.tick_row(soak.Soak(), judged=True).met is False, "no ticks are not good ticks"
    for stops, seconds, met in (([(1.0, HANGS)], 60.0, False), ([], 1.0, True)):
        assert soak.stop_row(soak.Soak(seconds=seconds, stops=stops), realtime=True).met is met
    for growth_mb, met in ((0.0, True), (0.1, False)):
        memory = [{"gate": (9 + growth_mb * n, 5 + growth_mb * n)} for n in range(5)]
        times_s = [60.0 + 20 * n for n in range(5)]
        assert soak.memory_rows(soak.Soak(memory=memory, sampled_s=times_s))[1].met is met


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


TABLE_ROWS: list[dict[str, Any]] = [
    {"measure": "kill gate -> stop frame", "result": "p50 0.40 ms", "bar": "p99 < 2 ms", "met": True},
    {"measure": "one way", "result": "20 us (2 x floor)", "bar": "10 us", "met": False},
    {"measure": "floor", "result": "0.9 ms", "bar": "-", "met": None},
]
RAN = {"date": "2026-01-02", "commit": "", "cores": 2, "kernel": "6.1", "python": "3.11", "realtime": True}
RAN |= {"pty carriers": "ordinary", "took_s": 60, "steal": 0.01, "command": "python -m bench --kills 8"}
RUN = {"machine": RAN, "rows": TABLE_ROWS}
BEGIN, END = "<!-- run: generated -->\n", "\n<!-- end of run -->\n"
PAGE = f"before\n\n{BEGIN}old{END}\n{pages.HEAD}| one way | old | old | met |\n\nafter | that\n"


def test_the_page_has_every_row_in_the_run_s_order() -> None:
    assert pages.renewed(PAGE, RUN) == (
        "before\n\n<!-- run: generated -->\n"
        "**The run** is of 2026-01-02, at no commit: 2 cores, kernel 6.1, Python 3.11, with real-time rights, and the "
        "pty's bytes are carried at ordinary priority. It took 60 s, and the host took away 1.0% of the processors' "
        "time. `python -m bench --kills 8`\n"
        f"<!-- end of run -->\n\n{pages.HEAD}"
        "| kill gate -> stop frame | p50 0.40 ms | p99 < 2 ms | met |\n"
        "| one way | 20 us (2 x floor) | 10 us | **missed** |\n"
        "| floor | 0.9 ms | - |  |\n"
        "\nafter | that\n"
    )


def test_a_page_without_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="no table of measures"):
        pages.renewed(f"{BEGIN}old{END}", RUN)
    with pytest.raises(ValueError, match="no marks of the part 'run'"):
        pages.renewed(pages.HEAD, RUN)


def test_the_page_has_such_a_table() -> None:
    assert "| kill gate -> stop frame | p50 0.40 ms |" in pages.renewed(pages.PAGE.read_text(), RUN)


COUNT = 200
Timed = tuple[int, bytes]


def moves(*servos: int) -> list[Timed]:
    """A stream of this many periods, each servo in a frame of its own."""
    return [
        (turn * PERIOD_NS + place * 10 * MS, bus_servo_move([(servo, turn)], 40)[4:-1])
        for turn in range(COUNT)
        for place, servo in enumerate(servos)
    ]


def later(found: list[Timed], by_ns: int) -> list[Timed]:
    return [(t_ns + by_ns, data) for t_ns, data in found]


def even() -> Hops:
    made = moves(1, 3)
    return Hops(made, later(made, MS), later(made, 2 * MS))


def test_an_even_stream_has_no_jitter_however_long_its_hops_take() -> None:
    jitter, gate, written, arrived, lost = even().rows()
    assert (jitter.numbers["max_ms"], jitter.met) == (0.0, True)
    assert (gate.numbers["max_ms"], written.numbers["p50_ms"], arrived.numbers["p50_ms"]) == (0.0, 1.0, 1.0)
    assert lost.met


@pytest.mark.parametrize(("hop", "of_it_ms"), [(0, (6.0, 1.0, 1.0)), (1, (0.0, 7.0, 1.0)), (2, (0.0, 1.0, 7.0))])
def test_what_is_late_is_seen_at_its_hop(hop: int, of_it_ms: tuple[float, ...]) -> None:
    hops = even()
    for found in (hops.made, hops.written, hops.arrived)[hop:]:
        found[50::20] = later(found[50::20], 6 * MS)
    jitter, *of_it, lost = hops.rows()
    assert (jitter.met, jitter.numbers["max_ms"], lost.met) == (False, 6.0, True)
    assert tuple(row.numbers["max_ms"] for row in of_it) == of_it_ms


def test_a_move_that_is_lost_is_counted_and_a_gap_and_not_what_nobody_saw() -> None:
    hops = even()
    hops.written, hops.arrived = hops.written[5:-5], hops.arrived[8:-8]
    assert hops.rows()[-1].met, "before and after the others"
    del hops.arrived[40]
    *_, lost = rows = hops.rows()
    assert (lost.numbers["found"], lost.met, rows[0].numbers["max_ms"]) == (1, False, 40.0)


DRIVING = Stopped(0, MS, 2 * MS, 2 * MS, 0, True)
MOVING = Rested(ROWS[0], 8.0, 1.5, 3.9, 0, None, ())


def test_the_bar_of_a_stop_behind_the_arm_is_that_of_the_run_s_own_kills() -> None:
    silent = dataclasses.replace(MOVING, wheels_ms=None, wrong=("the arm was not stopped",))
    for stop, behind_met, wrong_met in (
        (dataclasses.replace(MOVING, wheels_ms=3.9), True, True),
        (dataclasses.replace(MOVING, wheels_ms=4.1), False, True),
        (silent, False, False),
    ):
        least, behind, rest, wrong = arm_kills.rows_of("gate", [DRIVING] * 5, [stop] * 5)
        assert (least.met, behind.met, rest.met, wrong.met) == (None, behind_met, True, wrong_met)
    assert not arm_kills.rows_of("gate", [], [MOVING])[1].met
