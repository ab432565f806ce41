"""Whether the wheels stand still, as the gyro shows it. Pure.

Wheels that turn shake the robot: the standard deviation of gyro x and of gyro y over a window tells. Measured on the
robot in rad/s: still 0.0016 to 0.0025, 0.2 m/s 0.005 to 0.006, 0.35 m/s 0.006 to 0.010, turning on the spot down to
0.004. The limit of 0.0035 is near to both sides, so one quiet window proves little: at 0.0040 a window of 0.45 s is
quiet by chance in every fourth stretch of 1.5 s. Hence the verdict is "still" when every window has been quiet for
another HOLD_NS.

How long both must be is a matter of computed chances. White noise at 110 Hz, 6,000,000 samples each; false still: 1.5 s
stretches with any such verdict; false shaking: share of the time.

    window + hold   false still at 0.0040 / 0.0043 / 0.0050   false shaking at 0.0025 / 0.0020
    0.45 + 0.00 s   25 %   / 3.3 %   / 0.01 %                 0.00009 / 0
    0.40 + 0.20 s   1.6 %  / 0.04 %  / 0                      0.0017  / 0
    0.50 + 0.20 s   0.9 %  / 0.03 %  / 0                      0.0003  / 0
    0.50 + 0.25 s   0.6 %  / 0.014 % / 0                      0.0003  / 0
    0.60 + 0.30 s   0.2 %  / 0       / 0                      0.00004 / 0

A longer sum is safer and later, and the supervisor waits 1.5 s from the stop, of which the wheels take up to 0.75 s to
come to rest. docs/dev/telemetry.md has the delay, and what an IMU of another rate makes of it.
"""

from __future__ import annotations

from failstop.policy.proofs import LEAST_SAMPLES, WINDOW_NS

HOLD_NS = 250_000_000
GAP_NS = 100_000_000
"""Between two samples of one window; the first one after a longer silence starts again."""
UNITS_PER_RADPS = 10_000_000
"""The sums are of integers, and so exact forever: no sum drifts, and a wild sample leaves nothing behind."""


class StillJudge:
    """Decides since when the wheels stand still. The gyro's bias does not matter: it is no deviation.

    What shakes less than the limit counts as still: on the robot a straight drive below some 0.08 m/s.
    """

    def __init__(self, std_radps: float) -> None:
        """`std_radps`: less on x and on y is quiet."""
        self._limit = (std_radps * UNITS_PER_RADPS) ** 2
        self._samples: list[tuple[int, int, int]] = []
        self._sums = (0, 0, 0, 0)
        """Of x, x squared, y, y squared of the samples."""
        self._begun_ns = 0
        self._last_ns = 0
        self._quiet_ns = (0, 0)
        """The first sample and the last of the first window of the present run of quiet ones; zeros: it is not."""
        self.still_ns = 0
        """Since when the wheels are still: all samples from then on are in quiet windows. 0: they turn, or nobody
        knows. A window that begins with the end of a movement is quiet as soon as the rest outweighs it, so this may be
        0.2 s early after a straight drive at 0.2 m/s, 0.4 s after a turn at 1.0 rad/s, and before the stop itself."""
        self.judged_ns = 0
        """The last sample that there is a verdict of; 0: there is none, as while the first quiet windows must hold."""

    def take(self, gx_radps: float, gy_radps: float, t_ns: int) -> None:
        """One sample, finite, with its bias or without. About 2 us."""
        if not 0 <= t_ns - self._last_ns <= GAP_NS:
            self._start(t_ns)
        self._last_ns = t_ns
        self._slide(round(gx_radps * UNITS_PER_RADPS), round(gy_radps * UNITS_PER_RADPS), t_ns)
        self.judged_ns = self.still_ns = 0
        whole = t_ns - self._begun_ns >= WINDOW_NS and len(self._samples) >= LEAST_SAMPLES
        if not (whole and self._judge(t_ns)):
            self._quiet_ns = (0, 0)

    def _start(self, t_ns: int) -> None:
        self._samples.clear()
        self._sums = (0, 0, 0, 0)
        self._begun_ns = t_ns

    def _slide(self, x: int, y: int, t_ns: int) -> None:
        """Take in a sample, let go of those that are older than the window."""
        sum_x, squares_x, sum_y, squares_y = self._sums
        samples = self._samples
        samples.append((t_ns, x, y))
        sum_x += x
        squares_x += x * x
        sum_y += y
        squares_y += y * y
        while t_ns - samples[0][0] > WINDOW_NS:
            _, x, y = samples.pop(0)
            sum_x -= x
            squares_x -= x * x
            sum_y -= y
            squares_y -= y * y
        self._sums = (sum_x, squares_x, sum_y, squares_y)

    def _judge(self, t_ns: int) -> bool:
        """True when this window is quiet."""
        sum_x, squares_x, sum_y, squares_y = self._sums
        count = len(self._samples)
        # The variance times count x (count - 1).
        spread_x = count * squares_x - sum_x * sum_x
        spread_y = count * squares_y - sum_y * sum_y
        if not spread_x and not spread_y:
            return False  # one value again and again is a sensor that has died, which proves nothing
        if max(spread_x, spread_y) >= self._limit * (count * (count - 1)):
            self.judged_ns = t_ns
            return False
        if not self._quiet_ns[0]:
            self._quiet_ns = (self._samples[0][0], t_ns)
        if t_ns - self._quiet_ns[1] >= HOLD_NS:
            self.judged_ns = t_ns
            self.still_ns = self._quiet_ns[0]
        return True
