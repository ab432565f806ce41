"""Stopping distance: how far the robot moves after a fault until it is at rest. It is computed from the settings, for
level ground."""

from __future__ import annotations

import math
from collections.abc import Iterator

from failstop.board.kinds import is_described, watchdog_of
from failstop.policy.kinematics import AXES
from failstop.policy.processes import PROCESSES
from failstop.policy.proofs import WATCHDOGS
from failstop.policy.settings import BY_KEY, Settings

DEATH_S = 0.02
"""The time from the death of a process until Hiwonder's board gets the stop, in seconds. For every other board,
OWN_LINE_S is added. The value has a margin: on a quiet machine, the measured time is about 1 ms, and on the shared
machine of docs/reference/faults.md, the p99 of every measurement is shorter than DEATH_S."""
SLACK_S = 0.015
"""The time from the deadline of a silent process until the stop, in seconds. The value comes from the same measurements
as DEATH_S."""
SILENCE_S = 0.02
"""The time from the end of a timeout until the board gets a speed of zero, in seconds, for every kind of board. At the
end of an interlock's timeout, the gate acts only at its next tick. At the end of any other timeout, it acts at once."""
OWN_LINE_S = 0.012
"""How much later than Hiwonder's board every other board gets a stop, in seconds. The serial line or the loop of
another board may be slower, or that board may miss the first stop and get a repeat. This value does not cover one case:
some boards drop frames that have no gap between them, and if a USB adapter removes the gaps, such a board gets a stop
about 0.02 s later still (docs/reference/measured.md)."""
BRAKING = "limits.braking_mps2"
WITHIN = "within {:.2f} m of any fault that failstop can detect"
"""The text with which every screen shows the longest stopping distance."""
Reaction = tuple[float, str]
"""(time, fault) for one fault that failstop can detect. `time`: for how long the wheels are still commanded to turn
after the fault, in s. `fault`: the fault in words."""


def distance_m(speed_mps: float, seconds: float, braking_mps2: float) -> float:
    """How far the base moves, in m, if it keeps the speed for `seconds` and then brakes until it is at rest."""
    return speed_mps * seconds + speed_mps**2 / (2 * braking_mps2)


def speed_mps(distance: float, seconds: float, braking_mps2: float) -> float:
    """The highest speed in m/s at which distance_m() is at most `distance` (m), for these `seconds` and this
    braking."""
    return braking_mps2 * (math.sqrt(seconds**2 + 2 * distance / braking_mps2) - seconds)


def fastest_mps(settings: Settings) -> float:
    """The highest speed that the base can have in any direction, m/s."""
    return math.hypot(settings["limits.vx_mps"], settings["limits.vy_mps"] * AXES[settings.text("wheels.layout")][1])


def reactions(settings: Settings) -> Iterator[Reaction]:
    """Every fault that failstop can detect while the base drives, with its reaction time. The first one is the death of
    a process."""
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
    """The longest stopping distance in m, and the fault that causes it. `share`: the speed limit, as a share of the
    speeds in the settings."""
    latest = max(reactions(settings))
    return distance_m(share * fastest_mps(settings), latest[0], settings[BRAKING]), latest


def sentences(settings: Settings) -> list[str]:
    """Sentences about the stopping distances, for people."""
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
