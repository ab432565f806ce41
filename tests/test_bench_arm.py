"""The arm's bench: what is late, lost or unlike its row is seen."""

import dataclasses

import pytest

from bench import arm_kills
from bench.arm_stream import PERIOD_NS, Hops
from failstop.board.servos import bus_servo_move
from failstop.lab.faults.arm import Rested
from failstop.lab.faults.arm_table import ROWS
from failstop.lab.trial import Stopped

MS = 1_000_000
COUNT = 200
Timed = tuple[int, bytes]


def moves(*servos: int) -> list[Timed]:
    """A stream of this many periods, each servo in a frame of its own."""
    found = []
    for turn in range(COUNT):
        for place, servo in enumerate(servos):
            t_ns = turn * PERIOD_NS + place * 10 * MS
            found.append((t_ns, bus_servo_move([(servo, turn)], 40)[4:-1]))
    return found


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


@pytest.mark.parametrize("hop", ["made", "written", "arrived"])
def test_what_is_late_is_seen_at_its_hop(hop: str) -> None:
    hops = even()
    index = ("made", "written", "arrived").index(hop)
    for which in ("made", "written", "arrived")[index:]:
        found = getattr(hops, which)
        found[50::20] = later(found[50::20], 6 * MS)
    jitter, *of_it, lost = hops.rows()
    assert jitter.met is False
    assert jitter.numbers["max_ms"] == 6.0
    assert [row.numbers["max_ms"] for row in of_it] == [
        6.0 if hop == "made" else 0.0,
        *(7.0 if hop == which else 1.0 for which in ("written", "arrived")),
    ]
    assert lost.met


def test_a_move_that_is_lost_is_counted_and_is_a_gap() -> None:
    hops = even()
    del hops.arrived[40]
    *_, lost = rows = hops.rows()
    assert (lost.numbers["found"], lost.met) == (1, False)
    assert rows[0].numbers["max_ms"] == 40.0


def test_what_the_bench_saw_before_and_after_the_others_is_not_lost() -> None:
    hops = even()
    hops.written, hops.arrived = hops.written[5:-5], hops.arrived[8:-8]
    assert hops.rows()[-1].met


DRIVING = Stopped(0, MS, 2 * MS, 2 * MS, 0, True)
MOVING = Rested(ROWS[0], 8.0, 1.5, 3.9, 0, None, ())


@pytest.mark.parametrize(("behind_ms", "met"), [(3.9, True), (4.1, False)])
def test_the_bar_of_a_stop_behind_the_arm_is_that_of_the_run_s_own_kills(behind_ms: float, met: bool) -> None:
    moving = dataclasses.replace(MOVING, wheels_ms=behind_ms)
    least, behind, rest, wrong = arm_kills.rows_of("gate", [DRIVING] * 5, [moving] * 5)
    assert (least.met, behind.met, rest.met, wrong.met) == (None, met, True, True)


def test_a_stop_that_never_came_is_no_good_time() -> None:
    silent = dataclasses.replace(MOVING, wheels_ms=None, wrong=("the arm was not stopped",))
    _, behind, _, wrong = arm_kills.rows_of("gate", [DRIVING] * 5, [silent] * 5)
    assert (behind.met, wrong.met) == (False, False)
    assert not arm_kills.rows_of("gate", [], [MOVING])[1].met
