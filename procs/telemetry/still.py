"""Still: judges from the gyro whether the wheels are still. Pure.

Turning wheels shake the robot. The shaking shows in the standard deviation of gyro x and y over a window of samples. A
single quiet window may be chance, so the verdict is "still" only after all windows were quiet for HOLD_NS, counted from
the end of the first quiet one.

docs/reference/telemetry.md has measurements: how often the verdict is wrong and how late it comes, for several values
of WINDOW_NS and HOLD_NS, and what changes with the rate of the IMU.
"""

from __future__ import annotations

from failstop.policy.proofs import LEAST_SAMPLES, WINDOW_NS

HOLD_NS = 250_000_000
GAP_NS = 100_000_000
"""The longest gap between two samples of one window. After a longer gap, a new window starts."""
UNITS_PER_RADPS = 10_000_000
"""Samples are added up as integers in this unit. So the sums are exact: they don't drift, and a single wild sample has
no lasting effect."""


class StillJudge:
    """Decides since when the wheels have been still. The gyro's bias makes no difference.

    Turning wheels count as still if they shake the robot by less than the limit. On the robot, this happens when it
    drives straight at less than about 0.08 m/s.
    """

    def __init__(self, std_radps: float) -> None:
        """`std_radps`: a window is quiet if the standard deviations of both x and y are below this."""
        self._limit = (std_radps * UNITS_PER_RADPS) ** 2
        self._samples: list[tuple[int, int, int]] = []
        self._sums = (0, 0, 0, 0)
        """The sums of x, x squared, y and y squared over all samples of the window."""
        self._begun_ns = 0
        self._last_ns = 0
        self._quiet_ns = (0, 0)
        """The first of the quiet windows, as the times of its first and last sample. All windows since then have been
        quiet. Zeros if the present window is not quiet."""
        self.still_ns = 0
        """Since when the wheels have been still: the time of the first sample in the quiet windows. 0 if the wheels
        turn, or if it is not known. The wheels may have stopped a little later than this, because a window is quiet as
        soon as they were at rest during most of it."""
        self.judged_ns = 0
        """The time of the newest sample, or 0 if it gives no verdict. There is no verdict, for example, while the
        windows are quiet but have not been quiet for HOLD_NS."""

    def add(self, gx_radps: float, gy_radps: float, t_ns: int) -> None:
        """Add one finite sample, with or without the bias. Takes about 2 us."""
        if not 0 <= t_ns - self._last_ns <= GAP_NS:
            self._samples.clear()
            self._sums, self._begun_ns = (0, 0, 0, 0), t_ns
        self._last_ns = t_ns
        self._slide(round(gx_radps * UNITS_PER_RADPS), round(gy_radps * UNITS_PER_RADPS), t_ns)
        self.judged_ns = self.still_ns = 0
        whole = t_ns - self._begun_ns >= WINDOW_NS and len(self._samples) >= LEAST_SAMPLES
        if not (whole and self._judge(t_ns)):
            self._quiet_ns = (0, 0)

    def _slide(self, x: int, y: int, t_ns: int) -> None:
        """Add a sample to the window, and drop the samples that are too old."""
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
        """Update the verdict from the present window. Returns True if the window is quiet."""
        sum_x, squares_x, sum_y, squares_y = self._sums
        count = len(self._samples)
        # The variance times count x (count - 1).
        spread_x = count * squares_x - sum_x * sum_x
        spread_y = count * squares_y - sum_y * sum_y
        if not spread_x and not spread_y:
            return False  # a sensor that repeats one value is broken, so it proves nothing
        if max(spread_x, spread_y) >= self._limit * (count * (count - 1)):
            self.judged_ns = t_ns
            return False
        if not self._quiet_ns[0]:
            self._quiet_ns = (self._samples[0][0], t_ns)
        if t_ns - self._quiet_ns[1] >= HOLD_NS:
            self.judged_ns = t_ns
            self.still_ns = self._quiet_ns[0]
        return True
