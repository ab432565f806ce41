"""The IMU: units, offsets and scales, and the calibration at the start with its two outcomes."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry import imu
from failstop.procs.telemetry.imu import Accelerometer, GyroBias

from .still import PERIOD_NS, RATE_HZ, S, Vector, dps, gyro, samples

# This robot's (behaviour).
OFFSETS_G = (0.0460, -0.0635, -0.0501)
SCALES = (1.0058, 0.9964, 1.0076)


def accelerometer(offsets_g: Vector, scales: Vector) -> Accelerometer:
    changed: dict[str, object] = {f"imu.offset_{axis}_g": offset for axis, offset in zip("xyz", offsets_g, strict=True)}
    return Accelerometer(Settings(changed | {f"imu.scale_{a}": scale for a, scale in zip("xyz", scales, strict=True)}))


def calibrate(tested: GyroBias, rates: list[Vector], *, start_ns: int = 0) -> list[str]:
    """Feed rates at 110 Hz; returns the lines for the journal."""
    notes = [tested.take(rate, start_ns + i * PERIOD_NS) for i, rate in enumerate(rates)]
    return [note for note in notes if note]


def spread(std_dps: float, seconds: float = 3.1) -> list[Vector]:
    """Rates whose standard deviation is exactly this on z, over any even number of samples."""
    return [dps(0.0, 0.0, 0.2 + (std_dps if i % 2 else -std_dps)) for i in range(round(seconds * RATE_HZ))]


def test_gyro_comes_in_degrees_and_leaves_in_rad_per_second() -> None:
    assert imu.radps(180.0, -90.0, 45.0) == pytest.approx((math.pi, -math.pi / 2, math.pi / 4))


@given(raw=st.tuples(*[st.floats(-16, 16)] * 3))
def test_acceleration_is_raw_less_offset_times_scale(raw: Vector) -> None:
    """Each axis has its own settings; the unit is m/s2."""
    found = accelerometer(OFFSETS_G, SCALES).mps2(*raw)
    wanted = [(r - o) * s * 9.80665 for r, o, s in zip(raw, OFFSETS_G, SCALES, strict=True)]
    assert found == pytest.approx(wanted)


def test_the_variance_to_publish_is_0_0012_squared() -> None:
    assert pytest.approx(0.0012**2) == records.RATE_VARIANCE


def test_the_defaults_are_3_s_of_at_most_0_3_deg_per_s_then_1_s_0_5_deg_per_s_20_s() -> None:
    settings = Settings()
    assert settings["imu.calibration_s"] == 3.0
    assert settings["imu.calibration_std_dps"] == 0.3
    assert settings["imu.tracking_rest_s"] == 1.0
    assert settings["imu.tracking_band_dps"] == 0.5
    assert settings["imu.tracking_tau_s"] == 20.0
    assert settings.on("imu.tracking")


def test_3_s_of_samples_give_their_mean_which_is_logged_with_count_and_deviation() -> None:
    """3 s at 110 Hz is up to the 331st or 332nd sample: the first that is 3 s after the first."""
    tested = gyro()
    rates = [dps(1.0, -2.0, 0.5 + (0.1 if i % 2 else -0.1) + i / 1e6) for i in range(3 * RATE_HZ + 2)]
    assert calibrate(tested, rates[:-2]) == []
    assert tested.calibrating
    (note,) = calibrate(tested, rates[-2:], start_ns=3 * RATE_HZ * PERIOD_NS)
    assert tested.calibrated
    assert tested.bias_radps == pytest.approx(dps(1.0, -2.0, 0.5 + 330.5 / 2e6), abs=1e-5)
    assert note.startswith("gyro bias [1.0000 -2.0000 0.5")
    assert "from 332 samples, std [0.0000 0.0000 0.1000] deg/s" in note or "from 331 samples" in note


@pytest.mark.parametrize("start_ns", [0, 1, 77 * S])
def test_the_3_s_end_with_the_first_sample_that_is_3_s_after_the_first(start_ns: int) -> None:
    tested = gyro()
    ends = [bool(tested.take(dps(0.1, 0.1, 0.1), start_ns + i * S // 100)) for i in range(400)]
    assert ends.index(True) == 300
    assert sum(ends) == 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("std_dps", "stands"), [(0.299, True), (0.301, False)])
def test_a_deviation_over_0_3_deg_per_s_on_any_axis_is_not_stationary(axis: int, std_dps: float, stands: bool) -> None:
    tested = gyro()
    (note,) = calibrate(tested, [(*rate[-axis:], *rate[:-axis]) for rate in spread(std_dps)])  # type: ignore[misc]
    assert note.startswith("gyro bias" if stands else "robot not stationary during gyro calibration")
    assert tested.calibrated is stands


def test_exactly_the_standard_deviation_is_stationary() -> None:
    tested = gyro(calibration_s=0.1, calibration_std_dps=0.25)
    for z_dps, t_ns in ((-0.25, 0), (0.25, S // 10)):
        tested.take(dps(0.0, 0.0, z_dps), t_ns)
    assert tested.calibrated


def test_the_settings_are_those_of_the_bias() -> None:
    changed: dict[str, object] = {"imu.calibration_s": 1.0, "imu.calibration_std_dps": 1.0, "imu.tracking_rest_s": 2.0}
    tested = GyroBias(Settings(changed | {"imu.tracking_band_dps": 5.0, "imu.tracking_tau_s": 10.0}))
    tested.follow(False, 0)
    rates = [dps(0.0, 0.0, 0.9 if i % 2 else -0.9) for i in range(101)]
    assert [i for i, rate in enumerate(rates) if tested.take(rate, i * S // 100)] == [100]
    assert tested.calibrated
    tested.inherit((0.0, 0.0, 0.0))
    tested.take(dps(0.0, 0.0, 4.9), 2 * S - S // 4)
    tested.take(dps(0.0, 0.0, 4.9), 2 * S - 1)
    assert tested.bias_radps == (0.0, 0.0, 0.0)
    tested.take(dps(0.0, 0.0, 4.0), 2 * S - 1 + S // 10)
    assert tested.bias_radps == pytest.approx(dps(0.0, 0.0, 0.04))


def test_after_a_calibration_that_failed_the_bias_is_zero_and_it_is_told_once() -> None:
    tested = gyro()
    (note,) = calibrate(tested, spread(5.0, seconds=10.0))
    assert "the bias stays zero until tracking moves it" in note
    assert not tested.calibrating
    assert tested.bias_radps == (0.0, 0.0, 0.0)
    assert tested.corrected((0.1, 0.2, 0.3)) == (0.1, 0.2, 0.3)


def test_gyro_is_published_less_its_bias() -> None:
    tested = gyro()
    calibrate(tested, [dps(0.3, -0.2, 0.1)] * 400)
    assert tested.corrected(dps(10.3, -0.2, -0.9)) == pytest.approx(dps(10.0, 0.0, -1.0))


@pytest.mark.parametrize("noise_radps", [0.0007, 0.0011])
def test_the_gyros_own_noise_at_rest_is_stationary(noise_radps: float) -> None:
    tested = gyro()
    tested.follow(False, 0)
    run = samples(3.1, 1, ramp_dps=0.0, walk_dps=0.0, noise_radps=noise_radps)
    notes = [note for t_ns, rate in run if (note := tested.take(rate, t_ns))]
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


@pytest.mark.parametrize(("gap_ns", "ends"), [(S // 2, True), (S // 2 + 1, False)])
def test_more_than_0_5_s_is_a_gap(gap_ns: int, ends: bool) -> None:
    tested = gyro(calibration_s=0.5)
    tested.take(dps(0.0, 0.0, 0.1), 7 * S)
    assert bool(tested.take(dps(0.0, 0.0, 0.1), 7 * S + gap_ns)) is ends


def test_a_gap_in_the_samples_begins_the_3_s_anew() -> None:
    """The board was away: what came before it says little about now."""
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
