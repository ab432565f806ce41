"""The judge of `python -m bench --beside`: what it calls slower, what it calls not known, and what its exit code is."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from bench import beside, ratio, stats, visit

MARGIN = 0.1
MUCH = visit.Amounts(kills=43, hangs=6, samples=60, seconds=15.0, seed=7)


def rounds(factor: float, count: int = 10, each: int = 30, drift: float = 0.0) -> list[ratio.Round]:
    """Rounds of a machine that gets slower by `drift` each, and a commit that takes `factor` times as long."""
    chance = np.random.default_rng(3)
    found: list[ratio.Round] = []
    for number in range(count):
        slow = 1 + drift * number
        there, here = (chance.lognormal(0, 0.1, each) * slow for _ in range(2))
        found.append((list(there), list(here * factor)))
    return found


@pytest.mark.parametrize(
    ("intervals", "said"),
    [
        ([(1.11, 1.30)], ratio.SLOWER),
        ([(1.10, 1.30), (0.50, 1.11), None], ratio.NOT_KNOWN),
        ([(0.50, 1.10), (0.50, 0.60)], ratio.NO_SLOWER),
    ],
)
def test_the_interval_is_the_verdict(intervals: list[tuple[float, float] | None], said: str) -> None:
    assert {ratio.verdict(interval, MARGIN) for interval in intervals} == {said}


@pytest.mark.parametrize("percentile", [50, 99])
@pytest.mark.parametrize(("factor", "said"), [(2.0, ratio.SLOWER), (0.7, ratio.NO_SLOWER)])
def test_what_takes_longer_is_slower(percentile: int, factor: float, said: str) -> None:
    found = ratio.compare(rounds(factor), percentile, MARGIN)
    assert found.verdict == said
    assert found.interval is not None
    assert found.interval[0] < found.value < found.interval[1]
    assert found.value == pytest.approx(factor, rel=0.15)


def test_a_machine_that_gets_slower_makes_no_commit_slower() -> None:
    assert ratio.compare(rounds(1.0, drift=1.0), 50, MARGIN).verdict == ratio.NO_SLOWER


@pytest.mark.parametrize(
    ("count", "each", "percentile", "known"),
    [
        *((10, 10, 99, True), (10, 9, 99, False), (8, 1, 50, True)),
        *((7, 1, 50, False), (5, 100, 50, False), (0, 0, 50, False)),
    ],
)
def test_too_little_is_not_known(count: int, each: int, percentile: int, known: bool) -> None:
    found = ratio.compare(rounds(9.0, count, each), percentile, MARGIN)
    assert (found.interval is not None, found.verdict) == (known, ratio.SLOWER if known else ratio.NOT_KNOWN)


def test_rounds_that_lack_a_sample_are_drawn_too() -> None:
    found = ratio.compare([*rounds(2.0), ([], []), ([1.0], [])], 50, MARGIN)
    assert found.verdict == ratio.SLOWER


def test_a_row_is_as_its_worst_part() -> None:
    parts = [ratio.NO_SLOWER, ratio.NO_SLOWER, ratio.NOT_KNOWN, ratio.SLOWER]
    assert [ratio.worst(parts[:size]) for size in range(5)] == [ratio.NOT_KNOWN, *parts]


def test_a_stop_that_does_not_come_is_slower() -> None:
    for slower, there, here in (
        *((False, (0, 9), (0, 9)), (True, (0, 9), (1, 9)), (False, (2, 9), (1, 9))),
        *((True, (1, 20), (1, 10)), (False, (0, 0), (0, 0))),
    ):
        said = ratio.SLOWER if slower else ratio.NO_SLOWER
        assert beside.Counted("stops missed", there, here).verdict == said


def test_the_rounds_share_the_whole() -> None:
    parts = [beside.share(MUCH, 10, turn) for turn in range(10)]
    assert [sum(getattr(one, of) for one in parts) for of in ("kills", "hangs", "samples")] == [43, 6, 60]
    assert (sum(one.seconds for one in parts), len({one.seed for one in parts})) == (pytest.approx(15.0), 10)


def told(ms: float, missed: int = 0, **more: float) -> dict[str, object]:
    """The record that a visit tells."""
    values = {"kill gate": ([ms] * 30, "ms"), "processor": ([ms], "%")}
    return {
        "values": {**values, **{measure: ([value], "ms") for measure, value in more.items()}},
        "counts": {"stops missed": (missed, 30)},
    }


def test_the_rows_are_what_both_sides_measured_in_every_round() -> None:
    rows, counts = beside.compared([(told(1, old=1), told(2, new=1))] * 8 + [(None, told(99)), (told(1), None)], MARGIN)
    assert [(row.measure, list(row.ratios)) for row in rows] == [("kill gate", [50, 99]), ("processor", [50])]
    assert {row.verdict for row in rows} == {ratio.SLOWER}
    assert {row.ratios[50].value for row in rows} == {2.0}
    assert [(one.there, one.here) for one in counts] == [((0, 240), (0, 240)), ((1, 10), (1, 10))]


def test_nothing_measured_is_no_row() -> None:
    nothing: dict[str, object] = {"values": {"hang of gate": ([], "ms")}, "counts": {}}
    assert beside.compared([(nothing, nothing)] * 8, MARGIN)[0] == []
    rows, counts = beside.compared([(told(1), None)] * 3, MARGIN)
    assert (rows, [count.verdict for count in counts]) == ([], [ratio.SLOWER])


def test_a_visit_tells_the_samples_of_every_row() -> None:
    made = stats.timing
    with visit.samples() as times:
        rows = [
            stats.timing("a", [1_000_000], p50_ms=None, p99_ms=None),
            stats.over_floor("b", [2_000_000], (1.0, 1.0, 1.0), p50=1.0, p99=1.0),
            stats.timing("a", [3_000_000], p50_ms=1.0, p99_ms=None),
            stats.limit("processor", 4.0, 6, "%"),
            stats.count("stops missed", 1, 9),
        ]
    assert stats.timing is made
    assert visit.as_record(rows, times) == {
        "values": {"processor": ([4.0], "%"), "a": ([1.0, 3.0], "ms"), "b": ([2.0], "ms")},
        "counts": {"stops missed": (1, 9)},
    }


def test_a_commit_that_is_none_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert beside.main("no-such-commit", MUCH, 1, MARGIN, None) == 2
    assert capsys.readouterr().err == "no such commit: no-such-commit\n"


@pytest.mark.parametrize(
    ("visits", "code", "said"),
    [
        ([told(1), told(2)], 1, "kill gate: slower\n    p50 there 1.00, here 2.00 ms: 2.00 x (2.00 to 2.00, slower)\n"),
        ([told(1), told(1, missed=1)], 1, "stops missed: slower\n    there 0 of 240, here 8 of 240\n"),
        ([told(2, missed=1), told(1)], 0, "slower: none\nnot known: none\n"),
        ([None, told(1)], 2, "visits that failed: no slower\n    there 8 of 8, here 0 of 8\n"),
    ],
)
def test_what_is_slower_is_the_exit_code(
    visits: list[beside.Said], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there, here = (beside.Side(name, tmp_path, sys.executable) for name in ("there", "here"))
    order = []

    def visited(side: beside.Side, _: visit.Amounts) -> beside.Said:
        order.append(side)
        return visits[side is here]

    taken = beside.visit_both(there, here, MUCH, 8, visited)
    assert order == [there, here, here, there] * 4
    out = tmp_path / "rows.json"
    assert beside.conclude(taken, MARGIN, {}, str(out)) == code
    assert said in capsys.readouterr().out
    verdicts = {row["verdict"] for row in json.loads(out.read_text())["rows"]}
    assert (ratio.SLOWER in verdicts) == (code == 1)
