"""A robot that stands still, as its gyro sees it: generated samples, and the heading that their integral makes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from random import Random

from failstop.policy.settings import Settings
from failstop.procs.telemetry.imu import RAD_PER_DEG, GyroBias

S = 1_000_000_000
RATE_HZ = 110
PERIOD_NS = S // RATE_HZ
NOISE_RADPS = 0.0009
OFFSETS_DPS = (0.4, -0.7, 0.25)

Vector = tuple[float, float, float]


def gyro(**changed: object) -> GyroBias:
    """A gyro's bias with the settings' defaults, but for what is changed."""
    return GyroBias(Settings({f"imu.{key}": value for key, value in changed.items()}))


def dps(x: float, y: float, z: float) -> Vector:
    """deg/s to rad/s."""
    return x * RAD_PER_DEG, y * RAD_PER_DEG, z * RAD_PER_DEG


def samples(
    duration_s: float, seed: int, *, ramp_dps: float, walk_dps: float, noise_radps: float = NOISE_RADPS
) -> Iterator[tuple[int, Vector]]:
    """(t_ns, rate in rad/s): white noise on a bias that warms up along a ramp, `ramp_dps` in all, and walks at random
    besides, `walk_dps` in all (one standard deviation)."""
    random = Random(seed)
    count = round(duration_s * RATE_HZ)
    step = walk_dps * RAD_PER_DEG / count**0.5
    ramp = ramp_dps * RAD_PER_DEG / count
    bias = [offset * RAD_PER_DEG for offset in OFFSETS_DPS]
    for i in range(count):
        bias = [value + ramp + random.gauss(0.0, step) for value in bias]
        x, y, z = (value + random.gauss(0.0, noise_radps) for value in bias)
        yield i * PERIOD_NS, (x, y, z)


def heading_drift_deg(tested: GyroBias, run: Iterable[tuple[int, Vector]]) -> float:
    """The furthest that the heading, integrated from the end of the calibration on, strays from zero."""
    tested.follow(False, 0)
    heading_rad = furthest_rad = 0.0
    last_ns = 0
    for t_ns, rate in run:
        calibrating = tested.samples is not None
        tested.add(rate, t_ns)
        if not calibrating:
            heading_rad += tested.corrected(rate)[2] * (t_ns - last_ns) * 1e-9
            furthest_rad = max(furthest_rad, abs(heading_rad))
        last_ns = t_ns
    return furthest_rad / RAD_PER_DEG
