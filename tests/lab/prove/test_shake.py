"""Judgements of the gyro, on generated noise of known kinds."""

from __future__ import annotations

import pytest

from failstop.procs.telemetry.still import StillJudge
from failstop_lab.prove import shake
from failstop_lab.prove.shake import Verdict
from tests.lab.prove.noise import DRIVE, RATE_HZ, STILL, TURN, S, gyro, level

STILL_NOISE = shake.noise(gyro((6.0, STILL), seed=77))
assert STILL_NOISE is not None


def test_noise_of_one_kind() -> None:
    found = shake.noise(gyro((5.0, DRIVE)))
    assert found is not None
    assert (found.std_x, found.std_y) == pytest.approx((DRIVE, DRIVE), rel=0.1)
    assert found.least < found.std_x < found.most
    assert (found.mean_x, found.mean_y) == pytest.approx((0.01, -0.01), abs=0.001)
    assert found.rate_hz == pytest.approx(RATE_HZ, rel=0.02)


@pytest.mark.parametrize(
    "samples",
    [[], gyro((0.3, STILL)), [(n * S // RATE_HZ, 0.01, 0.01) for n in range(400)], gyro((5.0, STILL))[::6]],
    ids=["none", "short", "dead", "18 Hz"],
)
def test_noise_that_says_nothing(samples: list[shake.GyroSample]) -> None:
    assert shake.noise(samples) is None


def test_the_limit_is_the_configured_one_where_that_fits() -> None:
    spinning = [level(DRIVE), level(TURN)]
    assert shake.limit(level(STILL), spinning, 0.0035) == 0.0035
    assert shake.limit(level(STILL), spinning, 0.0010) == pytest.approx((0.0024 * 0.85 * TURN) ** 0.5)
    assert shake.limit(level(STILL), spinning, 0.0050) == pytest.approx((0.0024 * 0.85 * TURN) ** 0.5)
    assert shake.limit(level(0.0040), spinning, 0.0035) is None


@pytest.mark.parametrize("std", [DRIVE, TURN])
def test_the_moment_of_rest(std: float) -> None:
    late_s = []
    for seed in range(40):
        spinning = shake.noise(gyro((3.0, std), seed=1000 + seed))
        assert spinning is not None
        found = shake.rest_ns(gyro((0.5 + 0.4, std), (1.5, STILL), seed=seed), STILL_NOISE, spinning)  # type: ignore[arg-type]
        assert found is not None
        late_s.append(found / S - 0.9)
    late_s.sort()
    assert abs(late_s[20]) < 0.03
    assert late_s[1] > -0.1
    assert late_s[-2] < 0.1


def test_wheels_that_turn_to_the_end_have_no_moment_of_rest() -> None:
    assert shake.rest_ns(gyro((2.0, DRIVE)), STILL_NOISE, level(DRIVE)) is None  # type: ignore[arg-type]


def test_the_running_verdict() -> None:
    samples = gyro((1.0, DRIVE), (1.5, STILL))
    verdict = Verdict(StillJudge(0.0035))
    assert not verdict.still(samples[:110])
    assert not verdict.still(samples[:150]), "rest has only begun"
    assert verdict.still(samples)
    assert not Verdict(StillJudge(0.0035)).still(gyro((1.0, STILL), (1.0, DRIVE))), "the last word counts"
    assert Verdict(StillJudge(0.0035), begin_ns=S).still(samples)
    assert not Verdict(StillJudge(0.0035), begin_ns=2 * S).still(samples), "too little after the beginning"


def test_turning_all_the_while() -> None:
    assert shake.turning(gyro((0.6, DRIVE)), 0.0035)
    assert not shake.turning(gyro((0.6, STILL)), 0.0035)
    assert not shake.turning([], 0.0035)


def test_a_silence_of_the_imu() -> None:
    samples = gyro((3.0, STILL))
    assert shake.blind_ns(samples, 0, 2 * S) == 0
    gapped = [sample for sample in samples if not S < sample[0] < 1.5 * S]
    after_ns = next(t_ns for t_ns, _, _ in gapped if t_ns > S)
    assert shake.blind_ns(gapped, 0, after_ns) == pytest.approx(0.5 * S, rel=0.05)
    waited = [(after_ns - number * S // 10_000, x, y) for number, (_, x, y) in enumerate(gapped[:20], 1)]
    heap = sorted([*gapped, *waited])
    assert shake.blind_ns(heap, 0, after_ns) == shake.blind_ns(gapped, 0, after_ns), "read together after the silence"
    assert shake.longest_silence_ns(samples, 0, 3 * S) == 0
    assert shake.longest_silence_ns(gapped, 0, 3 * S) == pytest.approx(0.5 * S, rel=0.05)
    assert shake.longest_silence_ns(gapped, 2 * S, 3 * S) == 0
    assert shake.blind_ns(gapped, round(1.2 * S), after_ns) == pytest.approx(0.3 * S, rel=0.05)
