"""Wheel odometry: the gated command, integrated."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry.odometry import MEAN_NS, SLIP, Odometry

MS = 1_000_000
SPEED = st.floats(-1.0, 1.0)
VELOCITY = st.tuples(SPEED, SPEED, SPEED)


def unscaled() -> Odometry:
    return Odometry(Settings({"odometry.forward_scale": 1.0, "odometry.sideways_scale": 1.0}))


def driven(velocity: tuple[float, float, float] = (0.2, 0.0, 0.0)) -> Odometry:
    made = unscaled()
    made.follow(velocity, 0)
    return made


def pose(tested: Odometry) -> tuple[float, float, float]:
    return tested.x_m, tested.y_m, tested.th_rad


@pytest.mark.parametrize(
    ("changed", "forward", "sideways"),
    [({}, 1.0, 0.765), ({"odometry.forward_scale": 0.9, "odometry.sideways_scale": 0.5}, 0.9, 0.5)],
)
def test_ways_and_speeds_are_scaled_by_axis(changed: dict[str, object], forward: float, sideways: float) -> None:
    tested = Odometry(Settings(changed))
    tested.follow((0.2, 0.2, 0.0), 0)
    tested.advance(100 * MS)
    assert pose(tested) == pytest.approx((0.02 * forward, 0.02 * sideways, 0.0))
    assert (tested.vx_mps, tested.vy_mps, tested.wz_radps) == pytest.approx((0.2 * forward, 0.2 * sideways, 0.0))


def test_the_heading_is_that_of_the_middle_of_the_step() -> None:
    tested = driven((0.2, 0.1, 1.0))
    tested.advance(100 * MS)
    middle = 0.05
    x = (0.2 * math.cos(middle) - 0.1 * math.sin(middle)) * 0.1
    y = (0.2 * math.sin(middle) + 0.1 * math.cos(middle)) * 0.1
    assert pose(tested) == pytest.approx((x, y, 0.1))
    tested = driven((0.2, 0.0, 1.0))
    for t_ms in range(10, 6_284, 10):
        tested.advance(t_ms * MS)
    tested.advance(round(2 * math.pi * 1e9))
    assert pose(tested) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5), "a circle ends where it began"


@given(st.floats(-1e6, 1e6))
def test_th_is_wrapped_from_minus_pi_to_pi(angle: float) -> None:
    tested = unscaled()
    tested.inherit(0.0, 0.0, angle)
    found = tested.th_rad
    assert -math.pi <= found <= math.pi
    assert math.cos(found) == pytest.approx(math.cos(angle), abs=1e-6)
    assert math.sin(found) == pytest.approx(math.sin(angle), abs=1e-6)


def test_a_step_is_bounded_to_0_1_s_and_a_new_velocity_counts_from_its_own_time() -> None:
    tested = unscaled()
    for at_ns in (0, 100 * MS):
        tested.advance(at_ns)
    assert (pose(tested), tested.vx_mps, tested.vy_mps, tested.wz_radps) == ((0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    tested = driven()
    for at_ms, x_m in ((5_000, 0.02), (5_100, 0.04)):
        tested.advance(at_ms * MS)
        assert pose(tested) == pytest.approx((x_m, 0.0, 0.0)), "the lost time is lost, not owed"
    for velocity_mps, from_ms, x_m in ((0.0, 60, 0.012), (0.1, 60, 0.016)):
        tested = driven()
        tested.follow((velocity_mps, 0.0, 0.0), from_ms * MS)
        tested.advance(100 * MS)
        assert pose(tested) == pytest.approx((x_m, 0.0, 0.0))
    tested = driven()
    tested.advance(50 * MS)
    tested.follow((0.1, 0.0, 0.0), 40 * MS)
    assert pose(tested) == pytest.approx((0.01, 0.0, 0.0)), "a time before the last one takes nothing back"
    tested.advance(60 * MS)
    assert pose(tested) == pytest.approx((0.011, 0.0, 0.0))


def test_a_successor_goes_on_from_the_pose_and_the_twist_s_deviation_is_the_settings() -> None:
    tested = unscaled()
    tested.inherit(1.0, 2.0, math.pi / 2)
    tested.follow((0.2, 0.0, 0.0), 0)
    tested.advance(100 * MS)
    assert pose(tested) == pytest.approx((1.0, 2.02, math.pi / 2))
    assert Odometry(Settings()).twist_std == (0.05, 0.2)
    changed = Settings({"odometry.twist_std_mps": 0.1, "odometry.twist_std_radps": 0.3})
    assert Odometry(changed).twist_std == (0.1, 0.3)
    assert records.POSE_VARIANCE == 1e3


RIM_M, TRACK_M = math.pi * 0.08, 0.17165
Pose = tuple[float, float, float]
CORRELATED = (0.04, 0.01, 0.06, 0.09, -0.04, 0.5)
"""A covariance of a pose: xx, xy, x th, yy, y th, th th."""


def report(*turns: float, t_ms: int = 0, missed: float = 0.0, step: float = 0.0, rps: tuple[float, ...] = ()) -> Any:
    """How far the wheels have turned, as a board that counts reports it; with `rps`: as one that measures speeds."""
    return SimpleNamespace(turns=turns, missed=missed, t_ns=t_ms * MS, step=step, counts=not rps, speeds_rps=rps)


def two_wheels() -> Odometry:
    """The base of an Arduino: left and right wheel."""
    return Odometry(Settings({"board.kind": "arduino", "wheels.diameter_m": 0.08, "wheels.track_m": TRACK_M}))


def rolled(begun: Pose, turns: tuple[float, ...], lost: float = 0.0) -> Odometry:
    """After one report of two wheels, or of four mecanum wheels, from a pose with a covariance."""
    made = two_wheels() if len(turns) == 2 else unscaled()
    made.inherit(*begun, records.BY_ROLLING, CORRELATED, report(*[1.0] * len(turns)))
    made.roll(report(*[1.0 + turn for turn in turns], t_ms=100, missed=lost))
    return made


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize(
    "turns", [(0.5, 0.5), (0.4, 0.42), (-0.3, -0.29), (0.02, -0.02), (0.5, -0.3, 0.4, -0.2), (-0.1, 0.6, -0.2, 0.5)]
)
def test_the_covariance_of_a_move_is_what_small_errors_of_the_pose_and_of_each_wheel_make_of_it(
    turns: tuple[float, ...], lost: float
) -> None:
    """The judge does not know the formulas: it looks at poses that begin, or roll, a little differently."""
    begun, tiny = (1.0, 2.0, 0.7), 1e-6
    after = pose(rolled(begun, turns))

    def change(other: Odometry) -> list[float]:
        return [(there - here) / tiny for there, here in zip(pose(other), after, strict=True)]

    by_pose = [
        change(rolled((begun[0] + dx, begun[1] + dy, begun[2] + dth), turns))
        for dx, dy, dth in ((tiny, 0, 0), (0, tiny, 0), (0, 0, tiny))
    ]
    wheels = range(len(turns))
    by_wheel = [change(rolled(begun, tuple(turns[at] + tiny * (at == wheel) for at in wheels))) for wheel in wheels]
    xx, xy, xt, yy, yt, tt = CORRELATED
    before = ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))
    slip = SLIP["differential" if len(turns) == 2 else "mecanum"]
    variances = [slip**2 / RIM_M * abs(turn) + lost**2 for turn in turns]

    def expected(a: int, b: int) -> float:
        known = sum(by_pose[i][a] * before[i][j] * by_pose[j][b] for i in range(3) for j in range(3))
        return known + sum(way[a] * way[b] * variance for way, variance in zip(by_wheel, variances, strict=True))

    found = rolled(begun, turns, lost).covariance
    assert found == pytest.approx(
        [expected(0, 0), expected(0, 1), expected(0, 2), expected(1, 1), expected(1, 2), expected(2, 2)], rel=0.01
    )


def test_counting_in_steps_leaves_a_pose_as_unsure_as_a_step_and_no_more_with_each_report() -> None:
    tested = two_wheels()
    for at in range(5):
        tested.roll(report(0.0, 0.0, t_ms=100 * at, step=0.3))
    wheel = 0.3**2 / 6
    way, turn = 2 * (RIM_M / 2) ** 2 * wheel, 2 * (RIM_M / TRACK_M) ** 2 * wheel
    assert tested.covariance == pytest.approx((way, 0.0, 0.0, way, 0.0, turn))


def test_what_was_commanded_before_the_first_report_may_have_been_done_or_not() -> None:
    tested = unscaled()
    assert tested.covariance == (1e3, 0.0, 0.0, 1e3, 0.0, 1e3), "nobody should trust it"
    tested.follow((0.2, 0.3, -0.5), 0)
    tested.advance(100 * MS)
    tested.follow((-0.1, -0.1, 0.5), 100 * MS)
    tested.advance(200 * MS)
    tested.roll(report(7.0, 9.0, 7.0, 9.0, t_ms=200))
    assert tested.covariance == pytest.approx((0.07**2, 0.0, 0.0, 0.07**2, 0.0, 0.1**2))
    assert tested.t_ns == 200 * MS


def test_reports_of_another_number_of_wheels_count_for_nothing() -> None:
    tested = driven()
    tested.roll(report(1.0, 1.0))
    tested.roll(report())
    tested.advance(100 * MS)
    assert (tested.source, pose(tested)) == (records.BY_COMMANDS, pytest.approx((0.02, 0.0, 0.0)))


def test_a_curve_is_an_arc_and_not_its_length_straight_ahead() -> None:
    """A quarter of a circle of 1 m, in one report: both wheels' ways are those of their own circles."""
    inner, outer = ((1.0 + side * TRACK_M / 2) * math.pi / 2 / RIM_M for side in (-1, 1))
    tested = rolled((0.0, 0.0, 0.0), (inner, outer))
    assert pose(tested) == pytest.approx((1.0, 1.0, math.pi / 2))


def test_a_curve_of_a_base_that_moves_sideways_is_the_same_in_one_report_as_in_a_thousand() -> None:
    turns, parts = (1.0, 3.0, -2.0, 4.0), 1_000
    once, often = unscaled(), unscaled()
    for at in range(parts + 1):
        often.roll(report(*[at / parts * turn for turn in turns]))
    for share in (0.0, 1.0):
        once.roll(report(*[share * turn for turn in turns]))
    assert pose(once) == pytest.approx(pose(often), rel=1e-4)
    assert abs(once.th_rad) > 0.5
    assert min(map(abs, pose(once))) > 0.02


def test_turns_that_nobody_has_seen_make_a_base_at_rest_less_sure() -> None:
    tested = rolled((0.0, 0.0, 0.0), (0.0, 0.0))
    assert tested.covariance == CORRELATED
    tested.roll(report(1.0, 1.0, t_ms=200, missed=0.5))
    lost = tested.covariance
    assert lost[5] - CORRELATED[5] == pytest.approx(2 * (RIM_M / TRACK_M * 0.5) ** 2)
    tested.roll(report(1.0, 1.0, t_ms=300, missed=0.5))
    tested.roll(report(1.0, 1.0, t_ms=400, missed=0.0))
    assert tested.covariance == lost, "once, and a counter that begins again takes nothing back"


def test_speeds_of_a_board_that_counts_are_means_over_the_last_0_2_s() -> None:
    tested = two_wheels()
    speeds, turns = [], 0.0
    for at_ms, turn in ((0, 0.0), (50, 0.1), (100, 0.1), (150, 0.1), (200, 0.1), (250, 0.3), (300, 0.0), (1_300, 0.2)):
        turns += turn
        tested.roll(report(turns, turns, t_ms=at_ms))
        speeds.append(tested.vx_mps / RIM_M)
    whole, late, first = MEAN_NS / 1e9, 0.2, 0.1
    rising = [0.0, first / 0.05, 2 * first / 0.1, 3 * first / 0.15, 4 * first / whole]
    assert speeds == pytest.approx([*rising, 0.6 / whole, 0.5 / whole, late / 1.0])
    for at_ms, more, expected in ((1_300, 0.1, 0.3 / 1.0), (1_400, 0.2, 0.4 / 1.1), (1_500, 0.3, 0.3 / whole)):
        tested.roll(report(turns + more, turns + more, t_ms=at_ms))
        assert tested.vx_mps / RIM_M == pytest.approx(expected), "the first of two reports of one time begins a mean"


def test_the_mean_speeds_of_a_base_that_moves_sideways_are_its_way_in_that_time() -> None:
    tested = unscaled()
    turns = [0.0] * 4
    for at in range(3):
        turns = [turn + each for turn, each in zip(turns, (5e-4, 3e-4, -4e-4, -8e-4), strict=True)]
        tested.roll(report(*turns, t_ms=50 * at))
    twist = tested.vx_mps, tested.vy_mps, tested.wz_radps
    assert twist == pytest.approx([way / 0.1 for way in pose(tested)], rel=2e-3)
    assert all(twist)


def test_two_first_reports_of_one_time_say_nothing_of_a_speed() -> None:
    tested = two_wheels()
    for turns in (0.0, 0.5):
        tested.roll(report(turns, turns, t_ms=100))
    assert (tested.vx_mps, tested.vy_mps, tested.wz_radps) == (0.0, 0.0, 0.0)
    tested.roll(report(0.5, 0.5, t_ms=200))
    assert tested.vx_mps / RIM_M == pytest.approx(0.5 / 0.1, rel=1e-10)


def test_the_speeds_of_a_board_that_measures_them_are_the_base_s_at_once() -> None:
    tested = two_wheels()
    tested.roll(report(0.0, 0.0, rps=(0.5, 1.5)))
    twist = tested.vx_mps, tested.vy_mps, tested.wz_radps
    assert twist == pytest.approx((RIM_M, 0.0, RIM_M / TRACK_M))


def test_the_time_of_a_pose_is_that_of_the_newest_report_and_goes_back_for_none() -> None:
    tested = two_wheels()
    assert tested.t_ns == 0
    for at_ms, newest_ms in ((0, 0), (100, 100), (300, 300), (200, 300)):
        tested.roll(report(0.0, 0.0, t_ms=at_ms))
        assert tested.t_ns == newest_ms * MS


@given(st.lists(st.tuples(st.integers(0, 300), VELOCITY), max_size=40))
def test_it_goes_no_further_than_speed_times_bounded_time(steps: list[tuple[int, tuple[float, float, float]]]) -> None:
    tested = Odometry(Settings())
    t_ms, way_m, speed_mps = 0, 0.0, 0.0
    tested.follow((0.0, 0.0, 0.0), 0)
    for ms, velocity in steps:
        t_ms += ms
        tested.follow(velocity, t_ms * MS)
        way_m += speed_mps * min(ms, 100) / 1000
        speed_mps = math.hypot(velocity[0], velocity[1])
        assert math.hypot(tested.x_m, tested.y_m) <= way_m + 1e-9
        assert -math.pi <= tested.th_rad <= math.pi
