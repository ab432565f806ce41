"""The IMU: converts raw samples to m/s2 and rad/s, and finds and tracks the gyro's bias. Pure.

It does not estimate the robot's orientation, only how much of the measured turn rates is bias.
"""

from __future__ import annotations

from math import pi, sqrt

from failstop.policy.settings import Settings

Vector = tuple[float, float, float]

G_MPS2 = 9.80665
RAD_PER_DEG = pi / 180
LONGEST_GAP_NS = 500_000_000
"""The longest gap between two samples that belong together, in ns. If a calibration has a longer gap, it begins again.
After a calibration, the first sample after a longer gap does not move the bias. A sample counts in proportion to the
time since the one before it, so this sample would count as much as all the missing ones."""
LEAVE_STANDING = "leave it standing, restart the service"
NOT_STATIONARY = "robot not stationary during gyro calibration"


class Accelerometer:
    """Converts raw accelerations in g to m/s2: (raw - offset) x scale x 9.80665."""

    def __init__(self, settings: Settings) -> None:
        self._offsets_g = [settings[f"imu.offset_{axis}_g"] for axis in "xyz"]
        self._scales = [settings[f"imu.scale_{axis}"] * G_MPS2 for axis in "xyz"]

    def mps2(self, x_g: float, y_g: float, z_g: float) -> Vector:
        """Return the acceleration in m/s2, from a sample in g."""
        (offset_x, offset_y, offset_z), (scale_x, scale_y, scale_z) = self._offsets_g, self._scales
        return (x_g - offset_x) * scale_x, (y_g - offset_y) * scale_y, (z_g - offset_z) * scale_z


def radps(x_dps: float, y_dps: float, z_dps: float) -> Vector:
    return x_dps * RAD_PER_DEG, y_dps * RAD_PER_DEG, z_dps * RAD_PER_DEG


class GyroBias:
    """Finds the gyro's bias. The bias is calibrated at the start, and then follows the readings while the robot is at
    rest.

    calibrating -> calibrated  if the robot was still for the whole time. The mean of the samples is the bias.
                -> kept        if the robot moved, or if motion was commanded. People are warned, and the bias stays as
                               it was before the calibration (zero at the first start).

    After a calibration that succeeded, the bias is at first the plain average of all samples at rest, including those
    of the calibration. When the average covers one time constant (imu.tracking_tau_s), the bias begins to follow the
    samples with this time constant. After a calibration that failed, it follows them in this way at once.

    In a test with a constant bias, the heading of a robot at rest drifted by at most 0.10 degrees in 8 minutes (40
    seeds; docs/reference/telemetry.md).
    """

    def __init__(self, settings: Settings) -> None:
        self._calibration_ns = settings.ns("imu.calibration_s")
        self._std_radps = settings["imu.calibration_std_dps"] * RAD_PER_DEG
        """The largest standard deviation at which the robot counts as still, rad/s."""
        self._rest_ns = settings.ns("imu.tracking_rest_s")
        self._band_radps = settings["imu.tracking_band_dps"] * RAD_PER_DEG
        self._tau_s = settings["imu.tracking_tau_s"]
        self._averaged_s = self._tau_s
        """How much time the average covers, in s. It grows up to tau_s. From then on, the bias follows the samples with
        the time constant."""
        self._tracks = settings.on("imu.tracking")
        """False if the setting turns tracking off. The bias then never moves after the calibration."""
        self.samples: list[Vector] | None = [] if settings.on("board.imu") else None
        """The samples of the calibration. None once it has ended, or if the board has no IMU."""
        self._since_ns = 0
        self._last_ns: int | None = None
        self._resting_since_ns: int | None = None
        self.bias_radps: Vector = (0.0, 0.0, 0.0)
        self.calibrated = False
        self.stationary = True
        """False if the calibration was given up because the robot moved, or because motion was commanded."""
        self.tracking = False
        """True if the bias may follow the last sample, because the robot was at rest. The bias does not move if this
        sample came after too long a gap (LONGEST_GAP_NS)."""

    def inherit(self, bias_radps: Vector) -> None:
        """Continue with the bias that an earlier telemetry process found."""
        self.bias_radps = bias_radps
        self.calibrated = True
        self._averaged_s = self._tau_s

    def follow(self, commanded: bool, now_ns: int) -> str:
        """Record whether motion is commanded. Motion ends a calibration, and the bias does not change during motion.
        Returns a line for the journal if a calibration was given up, otherwise an empty text."""
        if not commanded:
            if self._resting_since_ns is None:
                self._resting_since_ns = now_ns
            return ""
        self._resting_since_ns = None
        self.tracking = False
        return self._not_stationary("it was told to drive") if self.samples is not None else ""

    def add(self, rate_radps: Vector, t_ns: int) -> str:
        """Add a raw sample. Returns a line for the journal if this sample ends a calibration, otherwise an empty
        text."""
        gap_ns = LONGEST_GAP_NS + 1 if self._last_ns is None else t_ns - self._last_ns
        self._last_ns = t_ns
        if self.samples is not None:
            return self._calibrate(self.samples, rate_radps, t_ns, gap_ns)
        self._track(rate_radps, t_ns, gap_ns)
        return ""

    def corrected(self, rate_radps: Vector) -> Vector:
        (x, y, z), (bias_x, bias_y, bias_z) = rate_radps, self.bias_radps
        return x - bias_x, y - bias_y, z - bias_z

    def _calibrate(self, samples: list[Vector], rate_radps: Vector, t_ns: int, gap_ns: int) -> str:
        if gap_ns > LONGEST_GAP_NS:
            samples.clear()
            self._since_ns = t_ns
        samples.append(rate_radps)
        if t_ns - self._since_ns < self._calibration_ns:
            return ""
        count = len(samples)
        mean_x, mean_y, mean_z = (sum(axis) / count for axis in zip(*samples, strict=True))
        means = (mean_x, mean_y, mean_z)
        stds = [
            sqrt(sum((value - mean) ** 2 for value in axis) / count)
            for axis, mean in zip(zip(*samples, strict=True), means, strict=True)
        ]
        if max(stds) > self._std_radps:
            return self._not_stationary(f"std {_dps(stds)} deg/s")
        self.samples = None
        self.bias_radps = means
        self.calibrated = True
        self._averaged_s = (t_ns - self._since_ns) * 1e-9
        return f"gyro bias {_dps(means)} deg/s from {count} samples, std {_dps(stds)} deg/s"

    def _not_stationary(self, why: str) -> str:
        self.samples = None
        self.stationary = False
        kept = "the bias found before is kept" if self.calibrated else "the bias stays zero until tracking moves it"
        return f"{NOT_STATIONARY} ({why}): {kept}"

    def _track(self, rate_radps: Vector, t_ns: int, gap_ns: int) -> None:
        since_ns = self._resting_since_ns
        self.tracking = (
            self._tracks
            and since_ns is not None
            and t_ns - since_ns >= self._rest_ns
            and all(abs(rate) <= self._band_radps for rate in self.corrected(rate_radps))
        )
        if self.tracking and 0 < gap_ns <= LONGEST_GAP_NS:
            dt_s = gap_ns * 1e-9
            # Until the average covers the time constant, each reading counts as much as each one before it. Otherwise
            # it would take three time constants to forget 3 s of noise, and the heading would be off by 20 s times the
            # error in those readings.
            self._averaged_s = min(self._averaged_s + dt_s, self._tau_s)
            step = min(dt_s / self._averaged_s, 1.0)
            (x, y, z), (bias_x, bias_y, bias_z) = rate_radps, self.bias_radps
            self.bias_radps = (bias_x + step * (x - bias_x), bias_y + step * (y - bias_y), bias_z + step * (z - bias_z))


def _dps(rates_radps: Vector | list[float]) -> str:
    return "[" + " ".join(f"{rate / RAD_PER_DEG:.4f}" for rate in rates_radps) + "]"
