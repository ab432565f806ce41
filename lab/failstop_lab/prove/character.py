"""Characterizing the robot: how rest and turning show at each velocity, by its IMU or by its board's reports."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable

from failstop.api.errors import FailstopError
from failstop.board.interface import BY_WHEELS
from failstop.policy import scale
from failstop.procs.telemetry.still import StillJudge
from failstop_lab.prove import pace, shake, sight
from failstop_lab.prove.run import MOST_S, NS, STAYS_S, STEADY_S, speed_up_s
from failstop_lab.prove.shake import Noise
from failstop_lab.prove.sight import ByImu, ByWheels, SeenSample, Sight, Unseen, Verdict
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import Turning

STILL_S = 3.0
SPIN_S = 2.0
STOOD_S = 1.0
"""Watched at rest, where the board reports its wheels."""
MOUNTED = "put the robot on a firmer stand, or mount the IMU more firmly"
SIMULATED = "the simulated board was held up, or its wheels were stopped; repeat on a quieter machine"
SUPPLIED = "check the motors' power, the encoders' plugs and board.per_rps"
NOT_AT_REST = "THE WHEELS DID NOT COME TO REST after {}: use the POWER SWITCH"


class Unfit(FailstopError):
    """The robot's rest can't be told from its turning: nothing can be proved."""


class WrongScale(FailstopError):
    """The wheels do not turn as fast as they are told: every speed here would be another one."""


class Restless(FailstopError):
    """The wheels do not stop."""


def characterize(stand: ProveStand, velocities: Iterable[Turning], *, quick: bool) -> Sight:
    """Measure. Raises Unfit, WrongScale, Restless, TrialError, FailstopError."""
    share = 0.6 if quick else 1.0
    if stand.means.observed_by == BY_WHEELS:
        return _by_wheels(stand, velocities, share)
    still = _collect(stand, STILL_S * share)
    return Unseen() if stand.means.may_be_blind and not still else _by_imu(stand, still, velocities, share)


def _by_imu(stand: ProveStand, stood: list[SeenSample], velocities: Iterable[Turning], share: float) -> ByImu:
    configured = stand.settings["still.std_radps"]
    still = _noise(stood, "at rest")
    spinning = {}
    for velocity in velocities:
        spinning[velocity.name] = _noise(_spin(stand, velocity, SPIN_S * share), f"at {velocity.words}")
        limit = shake.limit(still, list(spinning.values()), configured)
        stand.driver.robot.disable()
        if limit is None:
            raise Unfit(
                f"the IMU can't tell rest (up to {still.most:.4f} rad/s) from {velocity.words} "
                f"(from {spinning[velocity.name].least:.4f} rad/s): {SIMULATED if stand.board else MOUNTED}"
            )
        stand.watch.forget()
        _come_to_rest(stand, velocity, shake.Verdict(StillJudge(limit)))
    limit = shake.limit(still, list(spinning.values()), configured)
    assert limit is not None
    return ByImu(still, spinning, limit, configured)


def _by_wheels(stand: ProveStand, velocities: Iterable[Turning], share: float) -> ByWheels:
    """Nothing is known of how such robots roll: the bar of rest is made of how this one does."""
    stood = _collect(stand, STOOD_S)
    apart_ns = stand.language.reports.apart_ns
    judged = sight.rests(stood, apart_ns)
    if not judged or not judged[-1][1]:
        seen = "the board reports that its wheels turn" if judged else "the board does not report its wheels"
        raise Unfit(f"at rest: {seen}")
    found = ByWheels(sight.longest_gap_s(stood, apart_ns), {}, apart_ns=apart_ns)
    for velocity in velocities:
        turned = _spin(stand, velocity, SPIN_S * share)
        # Without the angle of steered wheels, which a frame carries behind the speeds.
        told_rps = pace.commanded_rps(stand.settings, velocity, stand.language)
        commanded = [(t_ns, speeds[: len(told_rps)]) for t_ns, speeds in stand.watch.commanded]
        begun_ns, true_rps = time.monotonic_ns(), stand.board.wheels() if stand.board else ()
        stand.driver.robot.disable()
        state = stand.driver.robot.state
        if state.cause and state.scale.wrong:
            # Wheels that are far too fast are stopped before they were at speed for long enough to be measured here.
            wrong = "; ".join(state.scale.wrong)
            raise WrongScale(f"at {velocity.words} {wrong}; correct it and run this again (a stop came: {state.cause})")
        if (ratio := pace.measured(turned, stand.language.reports, commanded)) is not None:
            found.speeds[velocity.name] = ratio
            holds, per_rps = stand.language.reports.holds_speed, stand.language.per_rps
            if wrong := scale.wheels_differ(ratio, per_rps, holds_speed=holds):
                raise WrongScale(f"at {velocity.words} {wrong}; correct it and run this again")
            if remark := scale.wheels_remark(ratio, per_rps):
                found = dataclasses.replace(found, notes=(*found.notes, f"at {velocity.words} {remark}"))
        elif true_rps and not found.notes:
            found = dataclasses.replace(found, notes=pace.of_simulated(true_rps, told_rps, stand.language.per_rps))
        if not found.turning(turned):
            if cause := stand.driver.robot.state.cause:
                raise Unfit(f"a stop came while the wheels should have turned: {cause}")
            raise Unfit(
                f"at {velocity.words} the board does not report that its wheels turn: "
                f"{SIMULATED if stand.board else SUPPLIED}"
            )
        found = dataclasses.replace(found, gap_s=max(found.gap_s, sight.longest_gap_s(turned, apart_ns)))
        _come_to_rest(stand, velocity, found.verdict(begun_ns))
        stand.run(STAYS_S)
        since = [sample for sample in stand.watch.samples if sample[0] >= begun_ns]
        rest_ns = sight.rest_ns(since, apart_ns)
        if rest_ns is None:
            raise Restless(NOT_AT_REST.format(velocity.words))
        found.rolled_s[velocity.name] = (rest_ns - begun_ns) / NS
    if stand.confirms_scale and found.speeds:
        found = dataclasses.replace(found, notes=(*found.notes, pace.CONFIRMS.format(stand.language.per_rps)))
    return found


def _spin(stand: ProveStand, velocity: Turning, seconds: float) -> list[SeenSample]:
    """The samples of wheels at speed."""
    stand.driver.velocity = velocity.command
    stand.driver.enable()
    stand.run(speed_up_s(stand, velocity) + STEADY_S / 2)
    return _collect(stand, seconds)


def _come_to_rest(stand: ProveStand, velocity: Turning, verdict: Verdict) -> None:
    if not stand.run(MOST_S, lambda: verdict.still(stand.watch.samples)):
        raise Restless(NOT_AT_REST.format(velocity.words))


def _collect(stand: ProveStand, seconds: float) -> list[SeenSample]:
    stand.watch.forget()
    stand.run(seconds)
    return list(stand.watch.samples)


def _noise(samples: list[SeenSample], when: str) -> Noise:
    found = shake.noise(samples)
    if found is None:
        span_s = (samples[-1][0] - samples[0][0]) / NS if samples else 0.0
        raise Unfit(f"{when}: {len(samples)} IMU samples in {span_s:.1f} s are too few, or all the same")
    return found
