"""Characterizing the robot: how it shakes at rest, and with its wheels turning at each velocity."""

from __future__ import annotations

from collections.abc import Iterable

from failstop.api.errors import FailstopError
from failstop.lab.prove import shake
from failstop.lab.prove.run import MOST_S, NS, STEADY_S, Character, speed_up_s
from failstop.lab.prove.shake import GyroSample, Noise, Verdict
from failstop.lab.prove.stand import Stand
from failstop.lab.prove.table import Turning

STILL_S = 3.0
SPIN_S = 2.0
MOUNTED = "lift the robot less softly, or mount the IMU firmly"
SIMULATED = "the simulated board was held up, or its wheels were stopped; repeat on a quieter machine"


class Unfit(FailstopError):
    """The robot's rest can't be told from its turning: nothing can be proved."""


class Runaway(FailstopError):
    """The wheels do not stop."""


def characterize(stand: Stand, velocities: Iterable[Turning], *, quick: bool) -> Character:
    """Measure. Raises Unfit, Runaway, TrialError, FailstopError."""
    configured = stand.settings["still.std_radps"]
    share = 0.6 if quick else 1.0
    still = _noise(_collect(stand, STILL_S * share), "at rest")
    spinning = {}
    for velocity in velocities:
        stand.driver.velocity = velocity.command
        stand.driver.enable()
        stand.run(speed_up_s(stand, velocity) + STEADY_S / 2)
        spinning[velocity.name] = _noise(_collect(stand, SPIN_S * share), f"at {velocity.words}")
        limit = shake.limit(still, list(spinning.values()), configured)
        stand.driver.robot.disable()
        if limit is None:
            raise Unfit(
                f"the IMU can't tell rest (up to {still.most:.4f} rad/s) from {velocity.words} "
                f"(from {spinning[velocity.name].least:.4f} rad/s): {SIMULATED if stand.board else MOUNTED}"
            )
        stand.watch.forget()
        verdict = Verdict(limit)
        if not stand.run(MOST_S, lambda verdict=verdict: verdict.still(stand.watch.samples)):  # type: ignore[misc]
            raise Runaway(f"THE WHEELS DID NOT COME TO REST after {velocity.words}: use the POWER SWITCH")
    limit = shake.limit(still, list(spinning.values()), configured)
    assert limit is not None
    return Character(still, spinning, limit, configured)


def _collect(stand: Stand, seconds: float) -> list[GyroSample]:
    stand.watch.forget()
    stand.run(seconds)
    return list(stand.watch.samples)


def _noise(samples: list[GyroSample], when: str) -> Noise:
    found = shake.noise(samples)
    if found is None:
        span_s = (samples[-1][0] - samples[0][0]) / NS if samples else 0.0
        raise Unfit(f"{when}: {len(samples)} IMU samples in {span_s:.1f} s are too few, or all the same")
    return found
