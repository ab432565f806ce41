"""Sight: how turning and resting wheels are told apart on one robot - by the gyro, by the board's reports of its
wheels, or not at all. Pure.

Whoever judges a row asks one of the three alike; `characterize` (character.py) finds out which fits, and its numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Protocol

from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge
from failstop_lab.prove import shake
from failstop_lab.prove.shake import Noise
from failstop_lab.prove.table import REST_RESOLUTION_S, Path, Turning

SeenSample = tuple[int, Any, Any]
"""When it was read (ns), and the gyro's x and y (rad/s), or the wheels' speeds and positions as the board reports."""

NS = 1e9
ROLLED = 1.5
"""How much longer than in its characterization a robot may roll, by its battery and its warmth."""


class Verdict(Protocol):
    """A running judgement over a list of samples that grows."""

    def still(self, samples: Sequence[SeenSample]) -> bool:
        """Whether its last word is that the wheels stand still."""


class Sight:
    """The judgements that a row needs."""

    by = ""
    """BY_IMU, BY_WHEELS; empty: nothing is seen."""
    source = ""
    """For people."""

    def verdict(self, begin_ns: int = 0) -> Verdict:
        """A judgement of the samples from then on."""
        raise NotImplementedError

    def turning(self, samples: Sequence[SeenSample]) -> bool:
        """Whether the wheels turned all the while."""
        raise NotImplementedError

    def rest_ns(self, samples: Sequence[SeenSample], velocity: str) -> int | None:
        """The moment of rest, after which nothing turns; None: there is none."""
        raise NotImplementedError

    def blind_ns(self, samples: Sequence[SeenSample], begin_ns: int, end_ns: int) -> int:
        """How long nothing was reported just before `end_ns`, where that is longer than usual; else 0."""
        return shake.blind_ns(samples, begin_ns, end_ns)

    def rest_bar_s(self, path: Path, velocity: Turning) -> float:
        """From the cause to wheels at rest, at most; 0: nobody sees it."""
        return path.rest_bar_s(velocity)

    def lines(self) -> list[str]:
        """For people: how this robot shows rest."""
        return []

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class ByImu(Sight):
    """A robot that shakes while its wheels turn."""

    still: Noise
    spinning: dict[str, Noise]
    limit_radps: float
    """The limit below which wheels are still here."""
    configured_radps: float

    by = "IMU"
    source = "IMU"

    def verdict(self, begin_ns: int = 0) -> shake.Verdict:
        return shake.Verdict(StillJudge(self.limit_radps), begin_ns)

    def turning(self, samples: Sequence[SeenSample]) -> bool:
        return shake.turning(samples, self.limit_radps)

    def rest_ns(self, samples: Sequence[SeenSample], velocity: str) -> int | None:
        return shake.rest_ns(samples, self.still, self.spinning[velocity])

    def lines(self) -> list[str]:
        lines = [f"IMU at rest        {_noise(self.still)}"]
        lines += [f"IMU at {name:<11} {_noise(noise)}" for name, noise in self.spinning.items()]
        if self.limit_radps == self.configured_radps:
            return [*lines, f"still.std_radps = {self.configured_radps:g} is between the two, so it fits this robot"]
        return [
            *lines,
            f"still.std_radps = {self.configured_radps:g} is not between the two: "
            f"set it to {self.limit_radps:.4f}, which this test uses",
        ]

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def _noise(noise: Noise) -> str:
    return (
        f"std x {noise.std_x:.4f} y {noise.std_y:.4f} rad/s, windows {noise.least:.4f} to {noise.most:.4f}, "
        f"{noise.rate_hz:.0f} Hz"
    )


@dataclasses.dataclass(frozen=True)
class ByWheels(Sight):
    """A board that reports its wheels."""

    gap_s: float
    """The longest time between two of its judged reports."""
    rolled_s: dict[str, float]
    """From a stop at a velocity to rest, as this robot took when it was characterized."""
    speeds: dict[str, float] = dataclasses.field(default_factory=dict)
    """At each velocity the measured speed of the wheels over the told one; empty: not known."""
    notes: tuple[str, ...] = ()
    """What else the report should say of the speeds."""
    apart_ns: int = 0
    """How far apart its reports of positions must be to be compared (WheelReports.apart_ns)."""

    by = "wheels"
    source = "board's report of its wheels"

    def verdict(self, begin_ns: int = 0) -> shake.Verdict:
        return shake.Verdict(ReadBack(self.apart_ns), begin_ns)

    def turning(self, samples: Sequence[SeenSample]) -> bool:
        judged = rests(samples, self.apart_ns)
        return bool(judged) and not any(still for _, still in judged)

    def rest_ns(self, samples: Sequence[SeenSample], velocity: str) -> int | None:
        return rest_ns(samples, self.apart_ns)

    def blind_ns(self, samples: Sequence[SeenSample], begin_ns: int, end_ns: int) -> int:
        silent_ns = shake.blind_ns(samples, begin_ns, end_ns)
        return silent_ns if silent_ns > 2 * self.gap_s * NS else 0

    def rest_bar_s(self, path: Path, velocity: Turning) -> float:
        """A rest is reported a gap late, and where positions tell it, two."""
        return path.reaction_ms / 1000 + ROLLED * self.rolled_s[velocity.name] + 2 * self.gap_s + REST_RESOLUTION_S

    def lines(self) -> list[str]:
        rolled = ", ".join(f"{seconds:.2f} s from {name}" for name, seconds in self.rolled_s.items())
        return [
            f"reports of the wheels are {self.gap_s:.2f} s apart at most; from a stop to rest they took {rolled}",
            *(f"at {name} the wheels turn {share:.2f} times as fast as told" for name, share in self.speeds.items()),
            *self.notes,
        ]

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def rests(samples: Sequence[SeenSample], apart_ns: int = 0) -> list[tuple[int, bool]]:
    """(when, whether the wheels stood) of each report that says it. `apart_ns`: WheelReports.apart_ns."""
    judge = ReadBack(apart_ns)
    told = ((t_ns, judge.add(speeds, positions, t_ns)) for t_ns, speeds, positions in samples)
    return [(t_ns, judge.still_ns > 0) for t_ns, judged in told if judged and judge.judged_ns]


def rest_ns(samples: Sequence[SeenSample], apart_ns: int = 0) -> int | None:
    """The first report of a rest that lasts; None: the last one tells of turning wheels, or there is none."""
    found = None
    for t_ns, still in rests(samples, apart_ns):
        found = (found or t_ns) if still else None
    return found


def longest_gap_s(samples: Sequence[SeenSample], apart_ns: int = 0) -> float:
    """Between two reports that say whether the wheels stand; 0: there are no two."""
    return max((two - one for (one, _), (two, _) in pairwise(rests(samples, apart_ns))), default=0) / NS


class _Nothing:
    def still(self, samples: Sequence[SeenSample]) -> bool:
        """Nobody says otherwise."""
        return True


class Unseen(Sight):
    """A board that reports neither its wheels nor an IMU."""

    def verdict(self, begin_ns: int = 0) -> Verdict:
        return _Nothing()

    def turning(self, samples: Sequence[SeenSample]) -> bool:
        return True

    def rest_ns(self, samples: Sequence[SeenSample], velocity: str) -> int | None:
        return None

    def rest_bar_s(self, path: Path, velocity: Turning) -> float:
        return 0.0

    def as_dict(self) -> dict[str, Any]:
        return {}
