"""The gyro's bias after the calibration: what moves it, what freezes it, and what that does to a heading."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.procs.telemetry.imu import GyroBias

from .still import PERIOD_NS, S, dps, gyro, heading_drift_deg, samples

EIGHT_MINUTES_S = 480
WORST_SEED = 6
"""Of 0 to 39, the seed whose calibration is furthest off."""


def resting(tau_s: float = 20.0) -> GyroBias:
    """Calibrated to zero, at rest for long."""
    tested = gyro(tracking_tau_s=tau_s)
    tested.follow(True, 0)
    tested.inherit((0.0, 0.0, 0.0))
    tested.follow(False, 0)
    tested.take((0.0, 0.0, 0.0), 10 * S)
    return tested


def test_it_follows_the_reading_with_a_time_constant_of_20_s() -> None:
    tested = resting()
    for i in range(1, 20 * 110 + 1):
        tested.take(dps(0.0, 0.0, 0.1), 10 * S + i * PERIOD_NS)
    assert tested.tracking
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.1 * (1 - 0.36788)), rel=1e-3)


@pytest.mark.parametrize(
    ("tau_s", "gap_ns", "weight"),
    [(20.0, S // 10, 0.005), (20.0, S // 2, 0.025), (20.0, S // 2 + 1, 0.0), (0.1, S // 4, 1.0)],
    ids=["dt over tau", "the longest", "after a gap", "at most 1"],
)
def test_the_weight_of_a_reading_is_its_time_over_the_constant(tau_s: float, gap_ns: int, weight: float) -> None:
    tested = resting(tau_s)
    tested.take(dps(0.0, 0.4, 0.2), 10 * S + gap_ns)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.4 * weight, 0.2 * weight))


def test_it_begins_when_zero_has_been_commanded_for_1_s() -> None:
    tested = resting()
    tested.follow(True, 11 * S)
    tested.follow(False, 20 * S)
    seen = []
    for t_ns in (20 * S + 990_000_000, 21 * S):
        tested.take(dps(0.0, 0.0, 0.1), t_ns)
        seen.append((tested.tracking, tested.bias_radps[2] > 0))
    assert seen == [(False, False), (True, True)]


def test_frozen_while_driving() -> None:
    tested = resting()
    tested.take(dps(0.0, 0.0, 0.0), 11 * S - PERIOD_NS)
    tested.follow(True, 11 * S)
    assert not tested.tracking, "at once, not with the next sample"
    for i in range(500):
        tested.take(dps(0.0, 0.0, 0.3), 11 * S + i * PERIOD_NS)
        assert not tested.tracking
    assert tested.bias_radps == (0.0, 0.0, 0.0)


def test_frozen_when_turned_by_hand() -> None:
    """More than 0.5 deg/s from the bias on any axis."""
    for axis in range(3):
        tested = resting()
        rate = [0.01, 0.01, 0.01]
        rate[axis] = 0.51
        for i in range(1, 500):
            tested.take(dps(*rate), 10 * S + i * PERIOD_NS)
        assert tested.bias_radps == (0.0, 0.0, 0.0)
        rate[axis] = 0.5
        tested.take(dps(*rate), 15 * S)
        assert tested.tracking, "exactly 0.5 is within"


def test_the_band_is_around_the_bias_and_not_around_zero() -> None:
    tested = resting()
    tested.inherit(dps(2.0, 2.0, 2.0))
    tested.take(dps(2.4, 1.6, 2.0), 10 * S + PERIOD_NS)
    assert tested.tracking
    tested.take(dps(0.1, 0.1, 0.1), 10 * S + 2 * PERIOD_NS)
    assert not tested.tracking


def test_the_bias_never_moves_where_tracking_is_off() -> None:
    tested = gyro(tracking="off")
    tested.follow(False, 0)
    for i in range(1000):
        tested.take(dps(0.0, 0.0, 0.1 if i < 400 else 0.2), i * PERIOD_NS)
        assert not tested.tracking
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.1))


@given(st.lists(st.tuples(st.integers(0, 400), *[st.floats(-1.0, 1.0)] * 3, st.booleans()), max_size=60))
def test_the_bias_never_leaves_what_was_within_the_band(steps: list[tuple[int, float, float, float, bool]]) -> None:
    """One reading moves it towards that reading, by no more than the band, and only at rest."""
    tested = resting()
    t_ns = 10 * S
    for ms, x, y, z, moving in steps:
        t_ns += ms * 1_000_000
        tested.follow(moving, t_ns)
        before, rate = tested.bias_radps, dps(x, y, z)
        tested.take(rate, t_ns)
        for was, now, reading in zip(before, tested.bias_radps, rate, strict=True):
            assert min(was, reading) - 1e-15 <= now <= max(was, reading) + 1e-15
            assert abs(now - was) <= dps(0.5, 0, 0)[0]
        assert not (moving and before != tested.bias_radps)


def calibrated(**changed: Any) -> tuple[GyroBias, int]:
    """Calibrated to zero, at rest, in 3 s; and the time of the last sample."""
    tested = gyro(**changed)
    tested.follow(False, 0)
    t_ns = 10 * S
    while tested.calibrating:
        t_ns += S // 100
        tested.take((0.0, 0.0, 0.0), t_ns)
    return tested, t_ns


def test_after_the_calibration_it_goes_on_as_the_mean_of_all_readings() -> None:
    """3 s of zeros, then 6 s of 0.3 deg/s: their mean is 0.2."""
    tested, t_ns = calibrated()
    for i in range(1, 601):
        tested.take(dps(0.3, 0.0, -0.3), t_ns + i * S // 100)
    assert tested.bias_radps == pytest.approx(dps(0.2, 0.0, -0.2), rel=1e-2)


@pytest.mark.parametrize(("tau_s", "settled_s"), [(20.0, 17.0), (2.0, 0.0)])
def test_the_step_is_dt_over_tau_once_20_s_are_averaged(tau_s: float, settled_s: float) -> None:
    """The calibration was 3 s of them. Just before, the step is still greater."""
    for early_s in (0.5, 0.0):
        tested, t_ns = calibrated(tracking_tau_s=tau_s)
        count = round((settled_s - early_s) * 100)
        for i in range(1, count + 1):
            tested.take((0.0, 0.0, 0.0), t_ns + i * S // 100)
        t_ns += max(count, 0) * S // 100
        tested.take(dps(0.0, 0.0, 0.4), t_ns + S // 100)
        step = tested.bias_radps[2] / dps(0.0, 0.0, 0.4)[2]
        wanted = 0.01 / tau_s
        assert (step == pytest.approx(wanted, rel=1e-3)) is (early_s == 0.0 or not settled_s)
        assert step == pytest.approx(wanted, rel=0.05)


def test_time_that_does_not_move_the_bias_is_not_averaged() -> None:
    tested, t_ns = calibrated()
    tested.follow(True, t_ns)
    for i in range(1, 3_001):
        tested.take((0.0, 0.0, 0.0), t_ns + i * S // 100)
    t_ns += 30 * S
    tested.follow(False, t_ns)
    tested.take((0.0, 0.0, 0.0), t_ns + S - S // 100)
    tested.take(dps(0.0, 0.0, 0.4), t_ns + S)
    assert tested.bias_radps[2] == pytest.approx(dps(0.0, 0.0, 0.4 * 0.01 / 3.02)[2], rel=0.02)


def test_a_bias_without_calibration_follows_by_the_time_constant_from_the_start() -> None:
    """Else the first reading would be the bias."""
    tested = gyro()
    tested.follow(False, 0)
    for i in range(1, 400):
        tested.take(dps(0.0, 0.0, 5.0 if i % 2 else -5.0), i * S // 100)
    assert not tested.calibrated
    tested.take(dps(0.0, 0.0, 0.4), 4 * S)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.4 * 0.01 / 20))


@pytest.mark.slow
def test_heading_drifts_less_than_0_15_degrees_in_8_minutes_at_rest() -> None:
    """A constant bias: of 40 such runs the worst strays by 0.098 degrees (median 0.066); with the time constant from
    the start 2 exceed 0.15 (worst 0.169), and this seed is its worst. One that warms up by 0.002 deg/s and walks by
    0.001 deg/s: with tracking the drift is the time constant times the change of the bias's estimate; of 40 such runs
    39 stay below 0.15 degrees (median 0.073, worst 0.156, where it is the bias that walks). Without: median 0.79, worst
    3.7."""
    assert heading_drift_deg(gyro(), samples(EIGHT_MINUTES_S, WORST_SEED, ramp_dps=0.0, walk_dps=0.0)) < 0.11
    run = list(samples(EIGHT_MINUTES_S, WORST_SEED, ramp_dps=0.002, walk_dps=0.001))
    with_deg, without_deg = (heading_drift_deg(gyro(tracking=tracks), run) for tracks in ("on", "off"))
    assert with_deg < 0.15
    assert without_deg > 4 * with_deg


@pytest.mark.slow
def test_a_bias_that_moves_0_15_dps_costs_3_degrees_with_tracking_and_36_without() -> None:
    """20 s x 0.15 deg/s; without, half of it over 480 s. The time constant is the price of not following the noise."""
    run = list(samples(EIGHT_MINUTES_S, 0, ramp_dps=0.15, walk_dps=0.0, noise_radps=0.0))
    with_deg, without_deg = (heading_drift_deg(gyro(tracking=tracks), run) for tracks in ("on", "off"))
    assert with_deg == pytest.approx(3.0, rel=0.06)
    assert without_deg == pytest.approx(36.0, rel=0.03)
