"""Stopping distance: how far the base goes from a fault until it stands, by the settings, on level ground."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from failstop.board.kinds import is_described, watchdog_of
from failstop.policy.processes import PROCESSES
from failstop.policy.settings import BY_KEY, Settings

DEATH_S = 0.005
"""From the death of a process to the stop at the first board (docs/dev/faults.md)."""
SLACK_S = 0.005
"""Between the end of a deadline and the stop."""
SILENCE_S = 0.02
"""Between the end of a timeout of commands or sensors and zero at the board: one period of the gate."""
OWN_LINE_S = 0.012
"""Another board's line and loop, and the repeats of a stop that it may need: so much later than the first board it
takes one. A USB adapter that forgets gaps adds 0.02 (docs/boards.md)."""
BRAKING = "limits.braking_mps2"
NO_PROCESS = "the cable is out or the machine is frozen"


class Reaction(NamedTuple):
    """A thing that fails, and for how long the wheels are told to turn after that."""

    what: str
    seconds: float
    """To the stop's arrival at the board; inf: nothing stops it."""


def distance_m(speed_mps: float, seconds: float, braking_mps2: float) -> float:
    """The way at this speed for so long, and then with this braking to rest."""
    return speed_mps * seconds + speed_mps**2 / (2 * braking_mps2)


def speed_mps(distance: float, seconds: float, braking_mps2: float) -> float:
    """The speed at which distance_m() is this `distance`, in m."""
    return braking_mps2 * (math.sqrt(seconds**2 + 2 * distance / braking_mps2) - seconds)


def fastest_mps(settings: Settings) -> float:
    """The fastest that the base may go, whichever way."""
    sideways = settings.text("wheels.layout") in ("mecanum", "omni3")
    return math.hypot(settings["limits.vx_mps"], settings["limits.vy_mps"] if sideways else 0.0)


def reactions(settings: Settings) -> Iterator[Reaction]:
    """Everything that may fail while the base drives. The board's own watchdog, where it has one, is the last."""
    kind = settings.board()[0]
    board_s = OWN_LINE_S if is_described(kind) else 0.0
    yield Reaction("a process of the service, or the program that drives, dies", DEATH_S + board_s)
    lease_s = settings["gate.lease_s"] + SLACK_S + board_s
    yield Reaction("the gate or the supervisor hangs", lease_s)
    for process in PROCESSES:
        if process.name != "gate":
            yield Reaction(f"{process.name} hangs", process.deadline_ns / 1e9 + SLACK_S + board_s)
    silent_s = max(timeout_ns for _, timeout_ns in settings.sources().values()) / 1e9
    yield Reaction("the program that drives falls silent", silent_s + SILENCE_S)
    if settings.on("scan.gate"):
        yield Reaction("the obstacle sensor falls silent", settings["scan.timeout_s"] + SILENCE_S)
    for name, (timeout_ns, _) in settings.interlocks().items():
        yield Reaction(f"the interlock {name} is no longer asserted", timeout_ns / 1e9 + SILENCE_S)
    yield Reaction(NO_PROCESS, watchdog_of(kind)[0] or math.inf)


def furthest(settings: Settings) -> tuple[float, Reaction]:
    """The longest way of all that software answers, in m, and what fails then."""
    speed, braking = fastest_mps(settings), settings[BRAKING]
    answered = [row for row in reactions(settings) if row.what != NO_PROCESS]
    latest = max(answered, key=lambda row: row.seconds)
    return distance_m(speed, latest.seconds, braking), latest


def told(settings: Settings) -> list[str]:
    """The distances in words, a line each."""
    speed, braking = fastest_mps(settings), settings[BRAKING]
    way, latest = furthest(settings)
    *_, frozen = reactions(settings)
    measured = "" if braking != BY_KEY[BRAKING].default else " (the default: measure yours)"
    beyond = "drives on: this board has no watchdog of its own"
    if frozen.seconds < math.inf:
        beyond = f"stands after {distance_m(speed, frozen.seconds, braking):.2f} m, by the board's own watchdog"
    return [
        f"From {speed:.2f} m/s, braking with {braking:g} m/s2{measured}, the robot stands at most {way:.2f} m after "
        f"whatever fails: {latest.what}, which is answered after {latest.seconds:.2f} s.",
        f"When a process dies it stands after {distance_m(speed, DEATH_S, braking):.2f} m.",
        f"When {NO_PROCESS}, it {beyond}.",
    ]
