"""The bench's judges: each bar is missed by what misses it, and by nothing at all having been measured."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from bench import __main__ as bench_main
from bench import hangs, kills, soak, stats
from failstop.trial import Stopped

MS = 1_000_000
GOOD = Stopped(0, MS, MS, MS, 0, True)


@pytest.mark.parametrize(
    ("samples_ms", "bars", "met"),
    [
        ([1, 1], {"p50_ms": 2.0, "p99_ms": None}, True),
        ([3, 3], {"p50_ms": 2.0, "p99_ms": None}, False),
        ([1, 9], {"p50_ms": None, "p99_ms": 5.0}, False),
        ([2, 2], {"p50_ms": 1.3, "p99_ms": None, "floor_ms": 1.0}, False),
        ([2, 2], {"p50_ms": 1.3, "p99_ms": None, "floor_ms": 2.0}, True),
        ([], {"p50_ms": 2.0, "p99_ms": 5.0}, False),
        ([9], {"p50_ms": None, "p99_ms": None}, None),
    ],
)
def test_times(samples_ms: list[int], bars: dict[str, float | None], met: bool | None) -> None:
    assert stats.timing("x", [ms * MS for ms in samples_ms], **bars).met is met


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
    rows = kills._rows([MS], [MS], {"gate": [GOOD, bad]}, "")
    assert [row.measure for row in rows if row.met is False] == [missed]
    assert not [row for row in kills._rows([MS], [MS], {"gate": [GOOD]}, "") if row.met is False]


def test_a_hang_that_is_noticed_late_misses_its_row() -> None:
    late_ns = round((60 + hangs.MARGIN_MS) * MS)
    assert [hangs._row("gate", 60.0, [ns]).met for ns in (late_ns - MS, late_ns)] == [True, False]
    assert hangs._row("gate", 60.0, []).met is False


def test_the_soak_s_bars() -> None:
    assert soak.tick_row(soak.Soak(), judged=True).met is False, "no ticks are not good ticks"
    false = soak.Soak(seconds=60.0, stops=[(1.0, "gate hangs")])
    assert (soak.stop_row(false, realtime=True).met, soak.stop_row(soak.Soak(seconds=1.0), realtime=True).met) == (
        False,
        True,
    )
    for growth_mb, met in ((0.0, True), (0.1, False)):
        times_s = [60.0 + 20 * n for n in range(5)]
        memory = [{"gate": (9 + growth_mb * n, 5 + growth_mb * n)} for n in range(5)]
        assert soak.memory_rows(soak.Soak(memory=memory, sampled_s=times_s))[1].met is met
    assert bench_main is not None
