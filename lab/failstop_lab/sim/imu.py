"""The board's IMU as it reports while the wheels turn: noise that follows the wheel speed, rotation, gravity.

The numbers are of a mecanum robot of 0.08 m wheels: standard deviation of gyro x and y 0.0016 to 0.0025 rad/s when
still, 0.005 to 0.006 at 0.2 m/s, 0.006 to 0.010 at 0.35 m/s, and down to 0.004 while turning on the spot.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import degrees, exp, hypot, isfinite, pi
from random import Random

WHEEL_DIAMETER_M = 0.08
# Half of wheelbase plus track.
TURN_LEVER_M = (0.17706 + 0.17165) / 2

# (wheel speed in m/s, standard deviation of gyro x and y in rad/s), straight lines between.
GYRO_NOISE = ((0.0, 0.0020), (0.20, 0.0055), (0.35, 0.0080), (2.0, 0.0200))
GYRO_Z_NOISE_RAD_S = 0.0009
ACCEL_NOISE_G = 0.004
# Driving shakes the accelerometer more: this much for each m/s.
ACCEL_NOISE_G_PER_MPS = 0.10

# Turning on the spot shakes less than driving at the same rim speed.
TURN_SHARE = 0.75
# The wheels are not still the moment their set point is 0, nor at speed the moment they are told.
SETTLING_S = 0.08
# A set point that is not a number turns the wheel somehow: taken as this.
WILD_MPS = 2.0


def rim_speeds_mps(speeds_rps: Sequence[float]) -> list[float]:
    """Wheel speeds at the rim in m/s; what is not finite or beyond the motor counts as its top speed."""
    top = WILD_MPS
    around_m = pi * WHEEL_DIAMETER_M
    return [max(-top, min(top, rps * around_m)) if isfinite(rps) else top for rps in speeds_rps]


def turn_rate_rad_s(speeds_rps: Sequence[float]) -> float:
    """Rotation of the robot about z (counter-clockwise positive) that the four wheel speeds make."""
    return -sum(rim_speeds_mps(speeds_rps)) / 4 / TURN_LEVER_M


def shaking_mps(speeds_rps: Sequence[float]) -> float:
    """The speed of straight driving (m/s) that shakes the IMU as much as these wheel speeds do."""
    rims = rim_speeds_mps(speeds_rps)
    turning = sum(rims) / 4
    driving = (sum((rim - turning) ** 2 for rim in rims) / 4) ** 0.5
    return hypot(driving, TURN_SHARE * turning)


def gyro_noise_rad_s(speed_mps: float) -> float:
    """Standard deviation of gyro x and y at a steady speed of straight driving."""
    for (low, low_std), (high, high_std) in pairwise(GYRO_NOISE):
        if speed_mps <= high:
            return low_std + (high_std - low_std) * (speed_mps - low) / (high - low)
    return GYRO_NOISE[-1][1]


class Imu:
    """The IMU of a robot that stands still at start_ns. `bias_rad_s` (x, y, z) may be set at any time."""

    def __init__(self, start_ns: int, seed: int) -> None:
        self.bias_rad_s = (0.0, 0.0, 0.0)
        self._gauss = Random(seed).gauss
        self._shaking_mps = 0.0
        self._turning_rad_s = 0.0
        self._last_ns = start_ns

    def sample(self, speeds_rps: Sequence[float], t_ns: int) -> tuple[float, float, float, float, float, float]:
        """One sample as on the wire: acceleration x y z in g, gyro x y z in deg/s. Times must not go back."""
        follow = 1.0 - exp((self._last_ns - t_ns) / (SETTLING_S * 1e9))
        self._last_ns = t_ns
        self._shaking_mps += follow * (shaking_mps(speeds_rps) - self._shaking_mps)
        self._turning_rad_s += follow * (turn_rate_rad_s(speeds_rps) - self._turning_rad_s)
        gauss = self._gauss
        gyro = gyro_noise_rad_s(self._shaking_mps)
        accel = ACCEL_NOISE_G + ACCEL_NOISE_G_PER_MPS * self._shaking_mps
        x, y, z = self.bias_rad_s
        return (
            gauss(0.0, accel),
            gauss(0.0, accel),
            gauss(1.0, accel),
            degrees(gauss(x, gyro)),
            degrees(gauss(y, gyro)),
            degrees(gauss(z + self._turning_rad_s, GYRO_Z_NOISE_RAD_S)),
        )
