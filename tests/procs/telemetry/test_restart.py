"""Signs of a restart of the board, and what looks like one."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.procs.telemetry.restart import COUNTERS, OBEYS_ZERO, RestartWatch
from tests.support.amounts import amount

MS = 1_000_000
PERIOD_NS = 10 * MS
SILENT_NS = 60 * MS


def steady(watch: RestartWatch, from_ns: int = 0, for_ns: int = 1_500 * MS) -> int:
    """Reports as they come; returns when the last one came."""
    now_ns = from_ns
    while now_ns < from_ns + for_ns:
        now_ns += PERIOD_NS
        assert watch.heard(1, 0, now_ns) == ""
    return now_ns


def signs(watch: RestartWatch, now_ns: int, count: int = 20) -> list[str]:
    return [sign for at in range(count) if (sign := watch.heard(1, 0, now_ns + at * PERIOD_NS))]


@pytest.mark.parametrize("pause_ms", [60, 75, 200, 1500])
def test_reports_that_paused_and_stayed_away_are_a_restart_found_once(pause_ms: int) -> None:
    watch = RestartWatch(SILENT_NS)
    now_ns = steady(watch) + pause_ms * MS
    assert signs(watch, now_ns) == [f"no report came for {pause_ms} ms"]


def test_reports_that_an_adapter_kept_are_none() -> None:
    rng = random.Random("kept")
    for _ in range(amount(200, 20_000)):
        watch = RestartWatch(SILENT_NS)
        last_ns = steady(watch)
        pause_ns = rng.randrange(60 * MS, 2_000 * MS)
        kept, pieces = pause_ns // PERIOD_NS, rng.randrange(1, 4)
        for piece in range(pieces):
            count = kept // pieces + (kept % pieces if piece == 0 else 0)
            assert watch.heard(count, 0, last_ns + pause_ns + piece * 5 * MS) == ""
        assert signs(watch, last_ns + pause_ns + 20 * MS) == []


def test_a_board_that_answers_while_its_reports_pause_has_not_restarted() -> None:
    watch = RestartWatch(SILENT_NS)
    last_ns = steady(watch)
    assert watch.heard(0, 1, last_ns + 100 * MS) == ""
    assert signs(watch, last_ns + 180 * MS) == []


def test_a_short_pause_or_one_before_the_rate_is_known_says_nothing() -> None:
    watch = RestartWatch(SILENT_NS)
    assert watch.heard(1, 0, MS) == ""
    assert signs(watch, 400 * MS) == []
    now_ns = steady(watch, 1_000 * MS)
    assert signs(watch, now_ns + 55 * MS) == []
    assert signs(RestartWatch(0), 10 * MS) == []


def drives(watch: RestartWatch, positions: Sequence[tuple[float, ...]], every_ms: int = 100) -> list[str]:
    return [watch.counted(each, at * every_ms * MS) for at, each in enumerate(positions, 1)]


def test_counters_that_fall_to_zero_from_afar_are_a_restart() -> None:
    way = [(100.0 * at, -100.0 * at) for at in range(40)]
    assert drives(RestartWatch(0), [*way, (0.0, 0.0), (100.0, -100.0)]) == [*[""] * 40, COUNTERS, ""]
    assert drives(RestartWatch(0), [*way, (90.0, -100.0)])[-1] == COUNTERS
    assert drives(RestartWatch(0), [*way, (3800.0, 0.0)])[-1] == "", "one of the two goes on"


def test_ordinary_moves_are_none() -> None:
    """Forward, backward, through zero, with stops and turns, and a board that counts from anywhere."""
    rng = random.Random("moves")
    for _ in range(amount(300, 30_000)):
        watch, at = RestartWatch(0), [rng.uniform(-50.0, 500.0), rng.uniform(-50.0, 500.0)]
        speed = [0.0, 0.0]
        for step in range(1, 60):
            if rng.random() < 0.2:
                speed = [rng.uniform(-20.0, 20.0), rng.uniform(-20.0, 20.0)]
            at = [way + new for way, new in zip(at, speed, strict=True)]
            found = watch.counted(tuple(at), step * 50 * MS)
            assert not found or max(map(abs, at)) <= 2.0, "a fall onto zero itself looks the same"


def over_zero(start: float, fastest: float, acceleration: float, every_s: float, off_s: float) -> list[float]:
    """A wheel rests for 6 s at `start`, and then drives backward by a ramp that begins `off_s` after a report."""
    found = [start] * round(6.0 / every_s)
    ramp_s, t_s = fastest / acceleration, every_s - off_s
    while found[-1] > -start:
        at_ramp_s = min(t_s, ramp_s)
        found.append(start - acceleration * at_ramp_s**2 / 2 - fastest * (t_s - at_ramp_s))
        t_s += every_s
    return found


@given(
    start=st.floats(1.0, 2000.0),
    fastest=st.floats(20.0, 5000.0),
    acceleration=st.floats(100.0, 50_000.0),
    every_ms=st.sampled_from([20, 50, 100, 200]),
    off=st.floats(0.0, 0.99),
)
@example(start=50.0, fastest=500.0, acceleration=1250.0, every_ms=100, off=0.0)
def test_a_robot_that_starts_from_rest_and_drives_over_zero_has_not_restarted(
    start: float, fastest: float, acceleration: float, every_ms: int, off: float
) -> None:
    """However hard it accelerates: in one report it goes many times as far as in the one before."""
    way = over_zero(start, fastest, acceleration, every_ms / 1000, off * every_ms / 1000)
    positions = [(float(round(at)), float(round(0.8 * at))) for at in way]
    assert not any(drives(RestartWatch(0, fastest), positions, every_ms))


@given(
    fastest=st.floats(200.0, 5000.0),
    share=st.floats(0.2, 1.0),
    every_ms=st.sampled_from([20, 50, 100, 200]),
    rests=st.booleans(),
    backward=st.booleans(),
)
def test_a_fall_that_no_wheel_can_make_is_a_restart_at_any_speed(
    fastest: float, share: float, every_ms: int, rests: bool, backward: bool
) -> None:
    """From twice as far as the fastest wheel goes from report to report, driving away from zero, toward it, or not."""
    step = share * fastest * every_ms / 1000
    far = [4 * fastest * every_ms / 1000 + 20.0 + step * at for at in range(20)]
    way = far[::-1] if backward else far
    way += [way[-1]] * (20 if rests else 0)
    found = drives(RestartWatch(0, fastest), [(at, -at) for at in [*way, 0.0]], every_ms)
    assert found == [*[""] * len(way), COUNTERS]


def test_zero_that_it_obeys_after_it_has_obeyed_what_drives_is_a_restart() -> None:
    watch = RestartWatch(0)
    assert watch.obeyed(zeros=True, told_ns=5) == "", "the first frame is still on its way"
    assert watch.obeyed(zeros=False, told_ns=5) == ""
    assert watch.obeyed(zeros=True, told_ns=5) == OBEYS_ZERO
    assert watch.obeyed(zeros=True, told_ns=5) == ""
    assert [watch.obeyed(zeros=zeros, told_ns=told) for zeros, told in ((False, 7), (True, 0), (False, 9))] == [""] * 3
    assert watch.obeyed(zeros=True, told_ns=11) == "", "it was told to stop and to drive again meanwhile"


def test_what_it_prints_counts_once_it_has_reported() -> None:
    watch = RestartWatch(SILENT_NS)
    assert watch.started("its boot text") == "", "the port was just opened"
    watch.heard(1, 0, MS)
    assert watch.started("it printed its boot text") == "it printed its boot text"
    assert watch.started("its boot text") == ""
