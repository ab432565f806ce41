"""Two commits compared: the ratio of a percentile, its interval by bootstrap, and the verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.stats import NEAREST

Round = tuple[Sequence[float], Sequence[float]]
"""The samples of one round: the other commit's samples, and this one's."""

LEAST_SAMPLES = {50: 8, 99: 100}
"""Percentile -> samples a side below which nothing is said of it: the median lies between the smallest and the largest
of eight with 99 %, and of fewer than a hundred the p99 is the largest."""
LEAST_ROUNDS = 6
"""Rounds below which nothing is said: a bootstrap of fewer has hardly anything to draw from."""
RESAMPLES = 2000
CONFIDENCE = 99.0
"""Per cent. With 95, one p99 in forty was slower by chance, and a run has some fifteen."""

SLOWER = "slower"
NO_SLOWER = "no slower"
NOT_KNOWN = "not known"


@dataclasses.dataclass(frozen=True)
class Ratio:
    """This commit's percentile over the other's; the interval is None where there is too little to have one."""

    there: float
    here: float
    value: float
    interval: tuple[float, float] | None
    verdict: str


def verdict(interval: tuple[float, float] | None, margin: float) -> str:
    """The verdict of an interval of ratios on a margin (0.1: a tenth slower): slower when all of it lies above, no
    slower when none of it does. Of many rows some lie wholly above 1 by chance; hardly one does so above the margin."""
    if interval is None:
        return NOT_KNOWN
    low, high = interval
    if low > 1 + margin:
        return SLOWER
    return NO_SLOWER if high <= 1 + margin else NOT_KNOWN


def worst(verdicts: Sequence[str]) -> str:
    """The verdict of a whole: slower if a part is, and no slower only if every part is."""
    return next((one for one in (SLOWER, NOT_KNOWN) if one in verdicts), NO_SLOWER if verdicts else NOT_KNOWN)


def compare(rounds: Sequence[Round], percentile: int, margin: float, seed: int = 1) -> Ratio:
    """The ratio of a percentile over all rounds. The bootstrap draws whole rounds, both sides of each: what slows a
    machine for a while slows both, and the samples of one visit are more alike than those of two."""
    sides = [_Side([one[side] for one in rounds], percentile) for side in (0, 1)]
    there, here = (side.value for side in sides)
    value = here / there if there else float("nan")
    used = [one for one in rounds if one[0] or one[1]]
    interval = None
    if len(used) >= LEAST_ROUNDS and min(side.size for side in sides) >= LEAST_SAMPLES[percentile]:
        drawn = np.random.default_rng(seed).multinomial(len(rounds), [1 / len(rounds)] * len(rounds), RESAMPLES)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = sides[1].redrawn(drawn) / sides[0].redrawn(drawn)
        outside = (100 - CONFIDENCE) / 2
        low, high = np.nanpercentile(ratios, (outside, 100 - outside))
        interval = (float(low), float(high))
    return Ratio(there, here, value, interval, verdict(interval, margin))


class _Side:
    """One commit's samples, in order, each with its round."""

    def __init__(self, rounds: Sequence[Sequence[float]], percentile: int) -> None:
        samples = np.array([sample for one in rounds for sample in one], float)
        of_round = np.array([number for number, one in enumerate(rounds) for _ in one], int)
        order = samples.argsort()
        self._samples, self._round = samples[order], of_round[order]
        self._share = percentile / 100
        self.size = samples.size
        self.value = float(np.percentile(samples, percentile, method=NEAREST)) if samples.size else float("nan")

    def redrawn(self, drawn: NDArray[Any]) -> NDArray[Any]:
        """The percentile of each resample; `drawn`: how often each round is in it."""
        weights = drawn[:, self._round].cumsum(axis=1)
        wanted = self._share * weights[:, -1:]
        found = self._samples[(weights >= wanted).argmax(axis=1)]
        return np.where(weights[:, -1] > 0, found, np.nan)
