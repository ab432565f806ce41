"""Whether the wheels stand, by what the board reports of them."""

from __future__ import annotations

from failstop.procs.telemetry.readback import READS_APART_NS, ReadBack

MS = 1_000_000
T0 = 1_000 * MS


def test_speeds_of_zero_are_rest_since_the_first_such_report() -> None:
    judge = ReadBack()
    assert judge.judged_ns == 0
    assert judge.take((0.5, 0.5), (), T0)
    assert (judge.still_ns, judge.judged_ns) == (0, T0)
    for at in (10, 20, 30):
        assert judge.take((0.0, -0.0), (), T0 + at * MS)
    assert (judge.still_ns, judge.judged_ns) == (T0 + 10 * MS, T0 + 30 * MS)
    judge.take((0.0, -0.1), (), T0 + 40 * MS)
    assert judge.still_ns == 0, "one wheel is enough"


def test_odometers_that_stay_are_rest_and_one_reading_is_none() -> None:
    judge = ReadBack()
    assert not judge.take((), (1.0, 2.0), T0)
    assert not judge.take((), (1.0, 2.0), T0 + READS_APART_NS - 1), "too close to say anything"
    assert judge.take((), (1.0, 3.0), T0 + READS_APART_NS)
    assert judge.still_ns == 0
    assert judge.take((), (1.0, 3.0), T0 + 2 * READS_APART_NS)
    assert judge.still_ns == judge.judged_ns == T0 + 2 * READS_APART_NS


def test_a_speed_of_zero_while_the_odometers_go_on_is_no_rest() -> None:
    judge = ReadBack()
    for at in range(3):
        judge.take((0.0, 0.0), (float(at), 0.0), T0 + at * READS_APART_NS)
    assert judge.judged_ns
    assert judge.still_ns == 0


def test_a_report_of_nothing_is_no_judgement() -> None:
    assert not ReadBack().take((), (), T0)
