"""Wheel odometry: the gated command, integrated."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry.odometry import Odometry

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
