"""Stopping distance: how far the robot goes after a fault until it is at rest, computed from the settings, on level
ground."""

from __future__ import annotations

import math
from collections.abc import Iterator

from failstop.board.kinds import is_described, watchdog_of
from failstop.policy.kinematics import AXES
from failstop.policy.processes import PROCESSES
from failstop.policy.proofs import WATCHDOGS
from failstop.policy.settings import BY_KEY, Settings

DEATH_S = 0.02
"""The time from the death of a process to the stop at the first board, s. No p99 in docs/reference/faults.md, measured
on a shared machine, is higher. On a quiet machine it is about 1 ms."""
SLACK_S = 0.015
"""The time from the end of a deadline to the stop, s, by the same measurements."""
SILENCE_S = 0.02
"""The time from the end of a timeout to zero at any board, s. The gate acts when the timeout ends, or, for an
interlock, one period later."""
OWN_LINE_S = 0.012
"""How much later than the first board another board gets a stop, s, because of its line, its loop, and the repeats of a
stop that it may need. A USB adapter that forgets gaps adds 0.02 (docs/boards.md)."""
BRAKING = "limits.braking_mps2"
WITHIN = "within {:.2f} m of any fault that failstop can detect"
"""The longest distance, in the words of every screen."""
Reaction = tuple[float, str]
"""How long after a failure the wheels are still told to turn, s, and what has failed."""


def distance_m(speed_mps: float, seconds: float, braking_mps2: float) -> float:
    """How far the base goes, m, if it keeps this speed for this time and then brakes to rest."""
    return speed_mps * seconds + speed_mps**2 / (2 * braking_mps2)


def speed_mps(distance: float, seconds: float, braking_mps2: float) -> float:
    """The speed at which distance_m() is `distance`, in m."""
    return braking_mps2 * (math.sqrt(seconds**2 + 2 * distance / braking_mps2) - seconds)


def fastest_mps(settings: Settings) -> float:
    """The highest speed of the base in any direction, m/s."""
    return math.hypot(settings["limits.vx_mps"], settings["limits.vy_mps"] * AXES[settings.text("wheels.layout")][1])


def reactions(settings: Settings) -> Iterator[Reaction]:
    """Every failure that failstop can detect while the base drives, with its time; a death is the first."""
    kind = settings.board()[0]
    board_s = OWN_LINE_S if is_described(kind) else 0.0
    yield DEATH_S + board_s, "a process of the service, or the program that drives, dies"
    yield settings["gate.lease_s"] + SLACK_S + board_s, "the gate or the supervisor hangs"
    for process in PROCESSES:
        if process.name != "gate":
            yield process.deadline_ns / 1e9 + SLACK_S + board_s, f"{process.name} hangs"
    silent_s = max(timeout_ns for _, timeout_ns in settings.sources().values()) / 1e9
    yield silent_s + SILENCE_S, "the program that drives falls silent"
    if settings.on("scan.gate"):
        yield settings["scan.timeout_s"] + SILENCE_S, "the obstacle sensor falls silent"
    if settings.on("attend.required"):
        yield settings["attend.lease_s"] + SILENCE_S, "the operator is not heard"
    for name, (timeout_ns, _) in settings.interlocks().items():
        yield timeout_ns / 1e9 + SILENCE_S + SLACK_S + board_s, f"the interlock {name} is no longer asserted"


def furthest(settings: Settings, share: float = 1.0) -> tuple[float, Reaction]:
    """The longest distance, in m, and the failure that causes it. `share`: the share of the settings' speeds."""
    latest = max(reactions(settings))
    return distance_m(share * fastest_mps(settings), latest[0], settings[BRAKING]), latest


def sentences(settings: Settings) -> list[str]:
    """The distances as sentences, one per line."""
    speed, braking = fastest_mps(settings), settings[BRAKING]
    way, (seconds, latest) = furthest(settings)
    (death_s, _), *_ = reactions(settings)
    acts_s, does = watchdog_of(settings.board()[0])
    measured = "" if braking != BY_KEY[BRAKING].default else " (the default; measure yours)"
    both = " (forward and sideways at once)" if AXES[settings.text("wheels.layout")][1] else ""
    beyond = "it drives on, because this board has no watchdog that failstop knows of"
    if does:
        beyond = f"the board's own watchdog acts after {speed * acts_s:.2f} m: {WATCHDOGS[does]}"
    if does == "zero":
        beyond = f"the board's own watchdog stops it within {distance_m(speed, acts_s, braking):.2f} m"
    return [
        f"At {speed:.2f} m/s{both}, braking with {braking:g} m/s2{measured}, the robot stops {WITHIN.format(way)}. "
        f"It reacts most slowly, after {seconds:.2f} s, when {latest}.",
        f"When a process dies, the robot stops within {distance_m(speed, death_s, braking):.2f} m.",
        f"When the cable is out or the computer is frozen, {beyond}. failstop can't stop a board that does not obey.",
    ]
