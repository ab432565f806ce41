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
    measured.add((30.0, -60.0), (), 10 * MS)
    assert measured.speeds_rps == (0.5, -1.0)
    assert measured.turns == (0.0, 0.0)


def test_turns_are_added_up_from_speeds_for_as_long_as_reports_come() -> None:
    measured = Measured(RPM)
    for at_ms, rpm in ((10, 0.0), (20, 60.0), (40, 60.0)):
        measured.add((rpm, -rpm), (), at_ms * MS)
    assert measured.turns == pytest.approx((0.025, -0.025)), "the mean of two reports, for the time between them"
    measured.add((60.0, -60.0), (), 30 * MS)
    assert measured.turns == pytest.approx((0.025, -0.025)), "a report that comes late takes nothing back"
    measured.add((60.0, -60.0), (), 240 * MS)
    assert measured.turns == pytest.approx((0.225, -0.225)), "what was lost for a while was as fast as before and after"
    assert measured.missed == 0.0
    measured.add((60.0, -60.0), (), 5_240 * MS)
    assert measured.turns == pytest.approx((0.725, -0.725)), "nobody knows how it went on after 0.5 s of silence"
    assert measured.missed == pytest.approx(5.0)


def counted(*reports: tuple[int, float, float]) -> Measured:
    """After reports of (time in ms, left, right) in counts."""
    measured = Measured(COUNTS)
    for at_ms, left, right in reports:
        measured.add((), (left, right), at_ms * MS)
    return measured


DRIVEN = ((100, 9000.0, 9100.0), (200, 9344.0, 9444.0), (300, 9688.0, 9788.0))
"""A turn a second, forward."""


def test_a_lost_report_of_counters_loses_nothing() -> None:
    measured = counted(*DRIVEN, (800, 11408.0, 11508.0))
    assert measured.turns == pytest.approx((2408 / 3436, 2408 / 3436))
    assert measured.speeds_rps == pytest.approx((1720 / 3436 / 0.5,) * 2)
    assert measured.missed == 0.0


@pytest.mark.parametrize("strange", [float("nan"), float("inf"), -float("inf"), 1e14, 9688.0 + 2**16 * 16])
def test_an_impossible_position_never_spreads_into_turns(strange: float) -> None:
    before = counted(*DRIVEN)
    after = counted(*DRIVEN, (400, strange, 10132.0))
    assert (after.turns, after.speeds_rps) == (before.turns, before.speeds_rps)
    after.add((), (10376.0, 10476.0), 500 * MS)
    assert after.turns == pytest.approx((1376 / 3436, 1376 / 3436)), "and the next report has all that was rolled"
    assert after.speeds_rps == pytest.approx((1.0, 1.0), rel=2e-3)


@pytest.mark.parametrize("speed", [float("nan"), float("inf"), 1e14])
def test_an_impossible_speed_is_no_report(speed: float) -> None:
    measured = Measured(RPM)
    for at_ms, rpm in ((10, 60.0), (20, speed), (30, 60.0)):
        measured.add((rpm, 60.0), (), at_ms * MS)
    assert measured.turns == pytest.approx((0.02, 0.02))
    assert measured.speeds_rps == (1.0, 1.0)


@pytest.mark.parametrize("silent_ms", [50, 100, 400, 2_500, 60_000])
@pytest.mark.parametrize("far", [300.0, 9_000.0, 3_000_000.0, -2_000_000_000.0])
@pytest.mark.parametrize("driving", [0.0, 343.6])
def test_a_board_that_restarts_moves_nothing(silent_ms: int, far: float, driving: float) -> None:
    """Its counters fall to zero, from anywhere, and it goes on from there."""
    reports = [(100 * at, far + driving * at, far + driving * at) for at in range(1, 4)]
    measured = counted(*reports)
    before = measured.turns
    for at, count in enumerate((0.0, 0.0, 34.0, 378.0, 722.0)):
        measured.add((), (count, count), (300 + silent_ms + 100 * at) * MS)
    assert measured.turns == pytest.approx([turns + 722 / 3436 for turns in before], abs=0.02)
    assert measured.missed == pytest.approx(driving / 343.6 * min(silent_ms / 1000, 1.0), abs=0.15)


def test_counters_that_somebody_has_set_to_anything_go_on_from_there() -> None:
    measured = counted(*DRIVEN, (400, 5_000_000.0, 5_000_000.0), (500, 5_000_344.0, 5_000_344.0))
    assert measured.turns == pytest.approx((1032 / 3436, 1032 / 3436))


@pytest.mark.parametrize("speed", [-343.6, -34.36, 3.0])
def test_a_way_through_zero_is_no_restart(speed: float) -> None:
    """Back over the place where the counters began, and slower and slower."""
    reports = [(100 * at, 1718.0 - abs(speed) + speed * at, 1718.0 - abs(speed) + speed * at) for at in range(1, 100)]
    measured = counted(*reports)
    assert measured.turns == pytest.approx((speed * 98 / 3436,) * 2)
    assert measured.missed == 0.0


def test_a_successor_goes_on_from_the_turns_and_says_what_it_may_have_missed() -> None:
    measured = Measured(COUNTS)
    measured.inherit((5.0, -5.0), (1.0, -2.0), 1_000 * MS)
    measured.add((), (70_000.0, 70_000.0), 1_100 * MS)
    measured.add((), (73_436.0, 73_436.0), 2_100 * MS)
    assert measured.turns == pytest.approx((6.0, -4.0))
    assert measured.missed == pytest.approx(0.2)


def test_a_successor_does_not_repeat_a_speed_from_before_its_gap() -> None:
    """The wheels may have stopped in between, as they do when telemetry is killed."""
    measured = Measured(COUNTS)
    measured.inherit((5.0, -5.0), (1.0, -2.0), 1_000 * MS)
    assert not measured.add((), (70_000.0, 70_000.0), 1_200 * MS)
    assert (measured.speeds_rps, measured.t_ns) == ((), 1_200 * MS)
    assert measured.add((), (70_000.0, 70_000.0), 1_300 * MS)
    assert measured.speeds_rps == (0.0, 0.0)
    assert not measured.add((), (70_000.0, 70_000.0), 1_301 * MS), "two of one read"
    assert not measured.add((), (9e12, 70_000.0), 1_400 * MS), "a jump that no wheel makes"


def test_another_number_of_wheels_begins_again() -> None:
    measured = counted(*DRIVEN)
    measured.add((), (1.0, 2.0, 3.0), 400 * MS)
    assert measured.turns == (0.0, 0.0, 0.0)


def test_positions_give_turns_and_speeds_across_a_wrap() -> None:
    measured = Measured(COUNTS)
    measured.add((), (2.0**31 - 1718.0, 0.0), 100 * MS)
    measured.add((), (1718.0 - 2.0**31, -3436.0), 600 * MS)
    assert measured.turns == pytest.approx((1.0, -1.0))
    assert measured.speeds_rps == pytest.approx((2.0, -2.0))


def test_a_board_that_reports_nothing_measures_nothing() -> None:
    measured = Measured(NO_WHEEL_REPORTS)
    measured.add((1.0, 1.0), (), 10 * MS)
    assert (measured.speeds_rps, measured.turns) == ((), ())


def fact_of(reports: list[tuple[int, float]], told_zero_ns: int) -> WheelFact:
    """The fact after reports of (time in ms, speed)."""
    fact, read_back = WheelFact(AFTER_NS), ReadBack()
    for t_ms, speed in reports:
        read_back.add((speed, speed), (), t_ms * MS)
        fact.update(read_back, StillJudge(0.0035), told_zero_ns, t_ms * MS)
    return fact


def test_nothing_read_is_nothing_known() -> None:
    fact = WheelFact(AFTER_NS)
    fact.update(ReadBack(), StillJudge(0.0035), 1, 10_000 * MS)
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
