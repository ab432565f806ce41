"""What is known of the wheels: from reports, from positions alone, from the IMU, and from nothing."""

import pytest

from failstop.board.interface import NO_WHEEL_REPORTS, WheelReports
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge
from failstop.procs.telemetry.wheels import (
    ARE_STILL,
    SEEN_BY_NOTHING,
    SEEN_BY_REPORTS,
    THEY_TURN,
    UNKNOWN_WHEELS,
    Measured,
    WheelFact,
)

MS = 1_000_000
AFTER_NS = 1500 * MS
COUNTS = WheelReports(250 * MS, 0.0, 3436.0, 2.0**32, True, False)
RPM = WheelReports(20 * MS, 60.0, 0.0, 0.0, False, True)


def test_reported_speeds_become_turns_a_second() -> None:
    measured = Measured(RPM)
    measured.take((30.0, -60.0), (), 10 * MS)
    assert measured.speeds_rps == (0.5, -1.0)
    assert measured.turns == ()


def test_positions_give_turns_and_speeds_across_a_wrap() -> None:
    measured = Measured(COUNTS)
    measured.take((), (2.0**31 - 1718.0, 0.0), 100 * MS)
    measured.take((), (1718.0 - 2.0**31, -3436.0), 600 * MS)
    assert measured.turns == pytest.approx((1.0, -1.0))
    assert measured.speeds_rps == pytest.approx((2.0, -2.0))


def test_a_board_that_reports_nothing_measures_nothing() -> None:
    measured = Measured(NO_WHEEL_REPORTS)
    measured.take((1.0, 1.0), (), 10 * MS)
    assert (measured.speeds_rps, measured.turns) == ((), ())


def fact_of(reports: list[tuple[int, float]], told_zero_ns: int) -> WheelFact:
    """The fact after reports of (time in ms, speed)."""
    fact, read_back = WheelFact(AFTER_NS), ReadBack()
    for t_ms, speed in reports:
        read_back.take((speed, speed), (), t_ms * MS)
        fact.follow(read_back, StillJudge(0.0035), told_zero_ns, t_ms * MS)
    return fact


def test_nothing_read_is_nothing_known() -> None:
    fact = WheelFact(AFTER_NS)
    fact.follow(ReadBack(), StillJudge(0.0035), 1, 10_000 * MS)
    assert (fact.does, fact.by, fact.unexpected) == (UNKNOWN_WHEELS, SEEN_BY_NOTHING, False)


def test_wheels_that_turn_on_after_zero_are_unexpected_when_their_time_is_over() -> None:
    reports = [(t_ms, 0.8) for t_ms in range(20, 3000, 20)]
    early, late = fact_of(reports[:75], 10 * MS), fact_of(reports, 10 * MS)
    assert (early.does, early.by, early.unexpected) == (THEY_TURN, SEEN_BY_REPORTS, False)
    assert (late.does, late.by, late.unexpected) == (THEY_TURN, SEEN_BY_REPORTS, True)


def test_wheels_that_begin_to_turn_long_after_zero_have_their_time_too() -> None:
    rest = [(t_ms, 0.0) for t_ms in range(20, 5000, 20)]
    pushed = [(t_ms, 0.2) for t_ms in range(5000, 6000, 20)]
    fact = fact_of([*rest, *pushed], 10 * MS)
    assert (fact.does, fact.unexpected) == (THEY_TURN, False)
    assert fact_of([*rest, *pushed, *((t_ms, 0.2) for t_ms in range(6000, 7000, 20))], 10 * MS).unexpected


def test_wheels_that_are_told_to_turn_are_expected_to() -> None:
    assert not fact_of([(t_ms, 0.8) for t_ms in range(20, 9000, 20)], 0).unexpected


def test_wheels_at_rest_are_still_since_their_first_report() -> None:
    fact = fact_of([(100, 0.8), (200, 0.0), (300, 0.0)], 10 * MS)
    assert (fact.does, fact.since_ns) == (ARE_STILL, 200 * MS)
