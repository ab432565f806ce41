"""Shaking, by the gyro: how much this robot shakes standing and turning its wheels, and when it came to rest. Pure.

The running verdict is procs/telemetry/still.py's, which needs three quarters of a second of rest. The moment is found
afterwards, with all samples in hand: that split of them which noise of the two known strengths makes likeliest.
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from failstop.policy.proofs import LEAST_SAMPLES, WINDOW_NS
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge

GyroSample = tuple[int, float, float]
"""(t_ns, gyro x, gyro y), in rad/s."""

STEP_NS = 50_000_000
"""Windows begin this far apart."""
BLIND_NS = 100_000_000
"""A silence of the IMU that is longer hides when the wheels came to rest."""
TOGETHER_NS = 2_000_000
"""Samples that are read closer to each other than this had waited: no board sends that fast."""
NS = 1e9


@dataclasses.dataclass(frozen=True)
class Noise:
    """One kind of shaking: over all of it, and the most and the least of any window of half a second, whose value is
    that of the louder axis."""

    std_x: float
    std_y: float
    least: float
    most: float
    mean_x: float
    mean_y: float
    rate_hz: float


def _std(values: Sequence[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / max(1, len(values) - 1))


def windows(samples: Sequence[GyroSample]) -> list[float]:
    """The louder axis' standard deviation in each window, rad/s."""
    found = []
    times = [sample[0] for sample in samples]
    begin_ns = times[0] if times else 0
    while times and begin_ns + WINDOW_NS <= times[-1]:
        part = samples[bisect_left(times, begin_ns) : bisect_right(times, begin_ns + WINDOW_NS)]
        if len(part) >= LEAST_SAMPLES:
            found.append(max(_std([sample[axis] for sample in part])[1] for axis in (1, 2)))
        begin_ns += STEP_NS
    return found


def noise(samples: Sequence[GyroSample]) -> Noise | None:
    """How much the samples of one stretch vary, all of it rest or all of it turning. None if the stretch is too short,
    or if the IMU is too slow or dead."""
    levels = windows(samples)
    if not levels or not max(levels):
        return None
    mean_x, std_x = _std([sample[1] for sample in samples])
    mean_y, std_y = _std([sample[2] for sample in samples])
    rate_hz = (len(samples) - 1) * NS / (samples[-1][0] - samples[0][0])
    return Noise(std_x, std_y, min(levels), max(levels), mean_x, mean_y, rate_hz)


def limit(still: Noise, spinning: Sequence[Noise], configured: float) -> float | None:
    """The limit of still, rad/s: the configured limit if it lies between all rest and all turning, else the middle;
    None when rest and turning can't be told apart."""
    quietest = min(each.least for each in spinning)
    if still.most < configured < quietest:
        return configured
    return math.sqrt(still.most * quietest) if still.most < quietest else None


def rest_ns(samples: Sequence[GyroSample], still: Noise, spinning: Noise) -> int | None:
    """The first sample of the rest, by the likeliest split; None: there is none, they shake to the end."""
    total = best = 0.0
    split = 0
    for index, sample in enumerate(samples):
        total += sum(
            _favour(sample[axis] - mean, rest, turning)
            for axis, mean, rest, turning in (
                (1, still.mean_x, still.std_x, spinning.std_x),
                (2, still.mean_y, still.std_y, spinning.std_y),
            )
        )
        if total > best:
            best, split = total, index + 1
    return samples[split][0] if split < len(samples) else None


def _favour(value: float, rest: float, turning: float) -> float:
    """How much likelier (logarithm) a value is while the wheels turn than at rest."""
    return math.log(rest / turning) + value * value / 2 * (1 / rest**2 - 1 / turning**2)


class Verdict:
    """Telemetry's running judgement over a list of samples that grows, from `begin_ns` on."""

    def __init__(self, judge: StillJudge | ReadBack, begin_ns: int = 0) -> None:
        self._judge = judge
        self._begin_ns = begin_ns
        self._taken = 0

    def still(self, samples: Sequence[tuple[int, Any, Any]]) -> bool:
        """Whether its last word is that the wheels stand still."""
        for t_ns, one, other in samples[self._taken :]:
            if t_ns >= self._begin_ns:
                self._judge.add(one, other, t_ns)
        self._taken = len(samples)
        return self._judge.still_ns > 0


def turning(samples: Sequence[GyroSample], std_radps: float) -> bool:
    """Whether the wheels turned all the while, as far as windows can tell."""
    levels = windows(samples)
    return bool(levels) and min(levels) >= std_radps


def blind_ns(samples: Sequence[GyroSample], begin_ns: int, end_ns: int, long_ns: int = BLIND_NS) -> int:
    """How long nothing was read just before `end_ns`; 0 when it was not for more than `long_ns`. Samples
    that had waited, as those of a port whose owner was gone, are read one right after the other: their times are
    one."""
    woken_ns, last_ns = end_ns, begin_ns
    for t_ns in (t_ns for t_ns, _, _ in reversed(samples) if t_ns < end_ns):
        if woken_ns - t_ns > TOGETHER_NS:
            last_ns = max(begin_ns, t_ns)
            break
        woken_ns = t_ns
    return end_ns - last_ns if woken_ns - last_ns > long_ns else 0


def longest_silence_ns(samples: Sequence[GyroSample], begin_ns: int, end_ns: int) -> int:
    """The IMU's longest silence within this time, ns. 0 if no two samples were far apart."""
    times = [t_ns for t_ns, _, _ in samples if begin_ns - BLIND_NS <= t_ns <= end_ns]
    return max((gap_ns for one, two in pairwise(times) if (gap_ns := two - one) > BLIND_NS), default=0)
