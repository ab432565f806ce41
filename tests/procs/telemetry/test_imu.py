"""The IMU: units, offsets and scales, the calibration at the start, and what moves the gyro's bias after it."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry import imu
from failstop.procs.telemetry.imu import Accelerometer, GyroBias

from .still import PERIOD_NS, RATE_HZ, S, Vector, dps, gyro, heading_drift_deg, samples

# This robot's (behaviour).
OFFSETS_G = (0.0460, -0.0635, -0.0501)
SCALES = (1.0058, 0.9964, 1.0076)


def accelerometer(offsets_g: Vector, scales: Vector) -> Accelerometer:
    changed: dict[str, object] = {f"imu.offset_{axis}_g": offset for axis, offset in zip("xyz", offsets_g, strict=True)}
    return Accelerometer(Settings(changed | {f"imu.scale_{a}": scale for a, scale in zip("xyz", scales, strict=True)}))


def calibrate(tested: GyroBias, rates: list[Vector], *, start_ns: int = 0) -> list[str]:
    """Feed rates at 110 Hz; returns the lines for the journal."""
    notes = [tested.add(rate, start_ns + i * PERIOD_NS) for i, rate in enumerate(rates)]
    return [note for note in notes if note]


def spread(std_dps: float, seconds: float = 3.1) -> list[Vector]:
    """Rates whose standard deviation is exactly this on z, over any even number of samples."""
    return [dps(0.0, 0.0, 0.2 + (std_dps if i % 2 else -std_dps)) for i in range(round(seconds * RATE_HZ))]


@given(raw=st.tuples(*[st.floats(-16, 16)] * 3))
def test_acceleration_is_raw_less_offset_times_scale_and_turning_in_radians(raw: Vector) -> None:
    found = accelerometer(OFFSETS_G, SCALES).mps2(*raw)
    assert found == pytest.approx([(r - o) * s * 9.80665 for r, o, s in zip(raw, OFFSETS_G, SCALES, strict=True)])
    assert imu.radps(180.0, -90.0, 45.0) == pytest.approx((math.pi, -math.pi / 2, math.pi / 4))
    assert pytest.approx(0.0012**2) == records.RATE_VARIANCE


def test_3_s_of_samples_give_their_mean_which_is_logged_with_count_and_deviation() -> None:
    """3 s at 110 Hz is up to the 331st or 332nd sample: the first that is 3 s after the first."""
    tested = gyro()
    rates = [dps(1.0, -2.0, 0.5 + (0.1 if i % 2 else -0.1) + i / 1e6) for i in range(3 * RATE_HZ + 2)]
    assert calibrate(tested, rates[:-2]) == []
    assert tested.samples is not None
    (note,) = calibrate(tested, rates[-2:], start_ns=3 * RATE_HZ * PERIOD_NS)
    assert tested.calibrated
    assert tested.bias_radps == pytest.approx(dps(1.0, -2.0, 0.5 + 330.5 / 2e6), abs=1e-5)
    assert note.startswith("gyro bias [1.0000 -2.0000 0.5")
    assert "from 332 samples, std [0.0000 0.0000 0.1000] deg/s" in note or "from 331 samples" in note
    less_bias = tested.corrected(dps(11.0, -2.0, -0.5))
    assert less_bias == pytest.approx(dps(10.0, 0.0, -1.0 - 330.5 / 2e6), abs=1e-5)


@pytest.mark.parametrize("start_ns", [0, 1, 77 * S])
def test_the_3_s_end_with_the_first_sample_that_is_3_s_after_the_first(start_ns: int) -> None:
    tested = gyro()
    ends = [bool(tested.add(dps(0.1, 0.1, 0.1), start_ns + i * S // 100)) for i in range(400)]
    assert ends.index(True) == 300
    assert sum(ends) == 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("std_dps", "stands"), [(0.299, True), (0.301, False)])
def test_a_deviation_over_0_3_deg_per_s_on_any_axis_is_not_stationary(axis: int, std_dps: float, stands: bool) -> None:
    tested = gyro()
    (note,) = calibrate(tested, [(*rate[-axis:], *rate[:-axis]) for rate in spread(std_dps)])  # type: ignore[misc]
    assert note.startswith("gyro bias" if stands else "robot not stationary during gyro calibration")
    assert tested.calibrated is tested.stationary is stands
    exact = gyro(calibration_s=0.1, calibration_std_dps=0.25)
    for z_dps, t_ns in ((-0.25, 0), (0.25, S // 10)):
        exact.add(dps(0.0, 0.0, z_dps), t_ns)
    assert exact.calibrated, "exactly the deviation is stationary"


def test_the_settings_are_those_of_the_bias() -> None:
    changed: dict[str, object] = {"imu.calibration_s": 1.0, "imu.calibration_std_dps": 1.0, "imu.tracking_rest_s": 2.0}
    tested = GyroBias(Settings(changed | {"imu.tracking_band_dps": 5.0, "imu.tracking_tau_s": 10.0}))
    tested.follow(False, 0)
    rates = [dps(0.0, 0.0, 0.9 if i % 2 else -0.9) for i in range(101)]
    assert [i for i, rate in enumerate(rates) if tested.add(rate, i * S // 100)] == [100]
    assert tested.calibrated
    tested.inherit((0.0, 0.0, 0.0))
    tested.add(dps(0.0, 0.0, 4.9), 2 * S - S // 4)
    tested.add(dps(0.0, 0.0, 4.9), 2 * S - 1)
    assert tested.bias_radps == (0.0, 0.0, 0.0)
    tested.add(dps(0.0, 0.0, 4.0), 2 * S - 1 + S // 10)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.04))


def test_after_a_calibration_that_failed_the_bias_is_zero_and_it_is_told_once() -> None:
    tested = gyro()
    (note,) = calibrate(tested, spread(5.0, seconds=10.0))
    assert "the bias stays zero until tracking moves it" in note
    assert tested.samples is None
    assert tested.bias_radps == (0.0, 0.0, 0.0)
    assert tested.corrected((0.1, 0.2, 0.3)) == (0.1, 0.2, 0.3)


@pytest.mark.parametrize("noise_radps", [0.0007, 0.0011])
def test_the_gyros_own_noise_at_rest_is_stationary(noise_radps: float) -> None:
    tested = gyro()
    tested.follow(False, 0)
    run = samples(3.1, 1, ramp_dps=0.0, walk_dps=0.0, noise_radps=noise_radps)
    notes = [note for t_ns, rate in run if (note := tested.add(rate, t_ns))]
    assert notes[0].startswith("gyro bias")
    assert tested.bias_radps == pytest.approx(dps(0.4, -0.7, 0.25), abs=5 * noise_radps / 330**0.5)


def test_told_to_drive_it_is_not_stationary_however_quiet_the_gyro() -> None:
    tested = gyro()
    tested.follow(False, 0)
    assert calibrate(tested, [dps(0.1, 0.1, 0.1)] * 100) == []
    assert tested.follow(True, S).startswith("robot not stationary during gyro calibration")
    assert tested.follow(True, 2 * S) == ""
    assert calibrate(tested, [dps(0.1, 0.1, 0.1)] * 600, start_ns=3 * S) == []
    assert not tested.calibrated


def test_a_robot_without_an_imu_that_is_told_to_drive_hears_of_no_calibration() -> None:
    assert GyroBias(Settings({"board.imu": "off"})).follow(True, S) == ""


def test_a_restarted_one_keeps_the_bias_it_had_until_it_has_a_new_one() -> None:
    tested = gyro()
    tested.inherit(dps(1.0, 1.0, 1.0))
    assert tested.calibrated
    assert "the bias found before is kept" in tested.follow(True, 0)
    assert tested.bias_radps == dps(1.0, 1.0, 1.0)
    again = gyro()
    again.inherit(dps(1.0, 1.0, 1.0))
    calibrate(again, [dps(2.0, 2.0, 2.0)] * 400)
    assert again.bias_radps == pytest.approx(dps(2.0, 2.0, 2.0))


def test_a_gap_of_more_than_0_5_s_in_the_samples_begins_the_calibration_anew() -> None:
    """The board was away: what came before it says little about now."""
    for gap_ns, ends in ((S // 2, True), (S // 2 + 1, False)):
        tested = gyro(calibration_s=0.5)
        tested.add(dps(0.0, 0.0, 0.1), 7 * S)
        assert bool(tested.add(dps(0.0, 0.0, 0.1), 7 * S + gap_ns)) is ends
    tested = gyro()
    calibrate(tested, [dps(5.0, 0.0, 0.0)] * 300)
    assert calibrate(tested, [dps(1.0, 0.0, 0.0)] * 300, start_ns=9 * S) == []
    assert calibrate(tested, [dps(1.0, 0.0, 0.0)] * 40, start_ns=9 * S + 300 * PERIOD_NS) != []
    assert tested.bias_radps == pytest.approx(dps(1.0, 0.0, 0.0))


@given(seed=st.integers(0, 1000), std_dps=st.floats(0.001, 0.2))
def test_the_bias_is_within_the_samples(seed: int, std_dps: float) -> None:
    random = Random(seed)
    tested = gyro(calibration_s=0.2)
    rates = [dps(*(random.gauss(0.5, std_dps) for _ in range(3))) for _ in range(30)]
    calibrate(tested, rates)
    for axis in range(3):
        values = [rate[axis] for rate in rates]
        assert min(values) <= tested.bias_radps[axis] <= max(values)


EIGHT_MINUTES_S = 480
WORST_SEED = 6
"""Of 0 to 39, the seed whose calibration is furthest off."""


def resting(tau_s: float = 20.0) -> GyroBias:
    """Calibrated to zero, at rest for long."""
    tested = gyro(tracking_tau_s=tau_s)
    tested.follow(True, 0)
    tested.inherit((0.0, 0.0, 0.0))
    tested.follow(False, 0)
    tested.add((0.0, 0.0, 0.0), 10 * S)
    return tested


def test_it_follows_the_reading_with_a_time_constant_of_20_s() -> None:
    tested = resting()
    for i in range(1, 20 * 110 + 1):
        tested.add(dps(0.0, 0.0, 0.1), 10 * S + i * PERIOD_NS)
    assert tested.tracking
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.1 * (1 - 0.36788)), rel=1e-3)


@pytest.mark.parametrize(
    ("tau_s", "gap_ns", "weight"),
    [(20.0, S // 10, 0.005), (0.1, 1, 1e-8), (20.0, S // 2, 0.025), (20.0, S // 2 + 1, 0.0), (0.1, S // 4, 1.0)],
    ids=["dt over tau", "the shortest", "the longest", "after a gap", "at most 1"],
)
def test_the_weight_of_a_reading_is_its_time_over_the_constant(tau_s: float, gap_ns: int, weight: float) -> None:
    tested = resting(tau_s)
    tested.add(dps(0.0, 0.4, 0.2), 10 * S + gap_ns)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.4 * weight, 0.2 * weight))


def test_the_bias_is_frozen_while_driving_and_until_1_s_of_rest() -> None:
    tested = resting()
    tested.add(dps(0.0, 0.0, 0.0), 11 * S - PERIOD_NS)
    tested.follow(True, 11 * S)
    assert not tested.tracking, "at once, not with the next sample"
    for i in range(500):
        tested.add(dps(0.0, 0.0, 0.3), 11 * S + i * PERIOD_NS)
        assert (tested.tracking, tested.bias_radps) == (False, (0.0, 0.0, 0.0))
    tested.follow(False, 20 * S)
    seen = []
    for t_ns in (20 * S + 990_000_000, 21 * S):
        tested.add(dps(0.0, 0.0, 0.1), t_ns)
        seen.append((tested.tracking, tested.bias_radps[2] > 0))
    assert seen == [(False, False), (True, True)]


def test_the_bias_is_frozen_when_turned_by_more_than_0_5_dps_on_any_axis() -> None:
    for axis in range(3):
        tested = resting()
        rate = [0.01, 0.01, 0.01]
        rate[axis] = 0.51
        for i in range(1, 500):
            tested.add(dps(*rate), 10 * S + i * PERIOD_NS)
        assert tested.bias_radps == (0.0, 0.0, 0.0)
        rate[axis] = 0.5
        tested.add(dps(*rate), 15 * S)
        assert tested.tracking, "exactly 0.5 is within"
    tested = resting()
    tested.inherit(dps(2.0, 2.0, 2.0))
    for number, (rates, tracks) in enumerate((((2.4, 1.6, 2.0), True), ((0.1, 0.1, 0.1), False)), 1):
        tested.add(dps(*rates), 10 * S + number * PERIOD_NS)
        assert tested.tracking is tracks, "the band is around the bias, and not around zero"


def test_the_bias_never_moves_where_tracking_is_off() -> None:
    tested = gyro(tracking="off")
    tested.follow(False, 0)
    for i in range(1000):
        tested.add(dps(0.0, 0.0, 0.1 if i < 400 else 0.2), i * PERIOD_NS)
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
        tested.add(rate, t_ns)
        for was, now, reading in zip(before, tested.bias_radps, rate, strict=True):
            assert min(was, reading) - 1e-15 <= now <= max(was, reading) + 1e-15
            assert abs(now - was) <= dps(0.5, 0, 0)[0]
        assert not (moving and before != tested.bias_radps)


def calibrated(**changed: Any) -> tuple[GyroBias, int]:
    """Calibrated to zero, at rest, in 3 s; and the time of the last sample."""
    tested = gyro(**changed)
    tested.follow(False, 0)
    t_ns = 10 * S
    while tested.samples is not None:
        t_ns += S // 100
        tested.add((0.0, 0.0, 0.0), t_ns)
    return tested, t_ns


def test_after_the_calibration_it_goes_on_as_the_mean_of_all_readings() -> None:
    """3 s of zeros, then 6 s of 0.3 deg/s: their mean is 0.2."""
    tested, t_ns = calibrated()
    for i in range(1, 601):
        tested.add(dps(0.3, 0.0, -0.3), t_ns + i * S // 100)
    assert tested.bias_radps == pytest.approx(dps(0.2, 0.0, -0.2), rel=1e-2)
    tested = gyro()  # without calibration it follows by the time constant: else the first reading would be the bias
    tested.follow(False, 0)
    for i in range(1, 400):
        tested.add(dps(0.0, 0.0, 5.0 if i % 2 else -5.0), i * S // 100)
    assert not tested.calibrated
    tested.add(dps(0.0, 0.0, 0.4), 4 * S)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.4 * 0.01 / 20))


@pytest.mark.parametrize(("tau_s", "settled_s"), [(20.0, 17.0), (2.0, 0.0)])
def test_the_step_is_dt_over_tau_once_20_s_are_averaged(tau_s: float, settled_s: float) -> None:
    """The calibration was 3 s of them. Just before, the step is still greater."""
    for early_s in (0.5, 0.0):
        tested, t_ns = calibrated(tracking_tau_s=tau_s)
        count = round((settled_s - early_s) * 100)
        for i in range(1, count + 1):
            tested.add((0.0, 0.0, 0.0), t_ns + i * S // 100)
        t_ns += max(count, 0) * S // 100
        tested.add(dps(0.0, 0.0, 0.4), t_ns + S // 100)
        step = tested.bias_radps[2] / dps(0.0, 0.0, 0.4)[2]
        wanted = 0.01 / tau_s
        assert (step == pytest.approx(wanted, rel=1e-3)) is (early_s == 0.0 or not settled_s)
        assert step == pytest.approx(wanted, rel=0.05)


def test_time_that_does_not_move_the_bias_is_not_averaged() -> None:
    tested, t_ns = calibrated()
    tested.follow(True, t_ns)
    for i in range(1, 3_001):
        tested.add((0.0, 0.0, 0.0), t_ns + i * S // 100)
    t_ns += 30 * S
    tested.follow(False, t_ns)
    tested.add((0.0, 0.0, 0.0), t_ns + S - S // 100)
    tested.add(dps(0.0, 0.0, 0.4), t_ns + S)
    assert tested.bias_radps[2] == pytest.approx(dps(0.0, 0.0, 0.4 * 0.01 / 3.02)[2], rel=0.02)


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
