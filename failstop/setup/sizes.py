"""Sizes and limits: the robot's figures, how fast it may drive, and the way that it then needs to stand."""

from __future__ import annotations

from collections.abc import Mapping

from failstop.cli import style
from failstop.policy.layouts import ACKERMANN
from failstop.policy.processes import PROCESSES
from failstop.policy.settings import Settings, declaration
from failstop.setup.talk import Talk, number, option

OF_LAYOUT = {
    "mecanum": ("wheels.diameter_m", "wheels.wheelbase_m", "wheels.track_m"),
    "differential": ("wheels.diameter_m", "wheels.track_m"),
    "omni3": ("wheels.diameter_m", "wheels.lever_m"),
    ACKERMANN: ("wheels.diameter_m", "wheels.wheelbase_m", "wheels.track_m"),
}
LIMITS = ("limits.vx_mps", "limits.vy_mps", "limits.wz_radps")
SIDEWAYS = ("mecanum", "omni3")
ASSUMED_MPS2 = 1.0
"""How fast a base is taken to slow down, where nobody has measured it."""
ON_THE_WIRE_S = 0.04
"""For the slowest of the boards to get the stop and obey it."""


def answer_key(key: str) -> str:
    """The question of a setting: `wheels.track_m` is track_m."""
    return key.partition(".")[2]


def reaction_s(settings: Settings) -> float:
    """The longest time from a fault that failstop answers to the stop on the wire: a program or a process that
    hangs."""
    return max(settings["gate.command_timeout_s"], *(row.deadline_ns / 1e9 for row in PROCESSES))


def distance_m(speed_mps: float, settings: Settings, slows_mps2: float = ASSUMED_MPS2) -> float:
    """The way at this speed from a fault to rest."""
    return speed_mps * (reaction_s(settings) + ON_THE_WIRE_S) + speed_mps**2 / (2 * slows_mps2)


def step(talk: Talk, values: Mapping[str, object]) -> dict[str, object]:
    """The fourth step. Raises Left."""
    talk.step(4, "Sizes and limits")
    talk.say("An empty line takes what stands in brackets.", style.DIM)
    settings = Settings(dict(values))
    chosen: dict[str, object] = {}
    layout = settings.text("wheels.layout")
    limits = [key for key in LIMITS if layout in SIDEWAYS or key != "limits.vy_mps"]
    for key in (*OF_LAYOUT[layout], *limits):
        chosen[key] = _number(talk, key, settings[key])
    made = Settings({**values, **chosen})
    fastest = made["limits.vx_mps"]
    told = (
        f"At {fastest:g} m/s the robot stands within {distance_m(fastest, made):.2f} m of whatever fails in software:"
    )
    told += f" {reaction_s(made):g} s until the slowest fault is noticed, {ON_THE_WIRE_S:g} s on the way, then"
    talk.say(f"{told} {ASSUMED_MPS2:g} m/s2 of braking, which nobody has measured on this robot.")
    return chosen


def _number(talk: Talk, key: str, now: float) -> float:
    declared = declaration(key)
    assert declared.low is not None
    assert declared.high is not None
    words = f"{declared.doc[0].upper()}{declared.doc[1:]}, {declared.unit}"
    return float(talk.ask(answer_key(key), words, f"{now:g}", number(declared.low, declared.high, declared.unit)))


OPTIONS = {
    answer_key(key): f"{declaration(key).doc}, {declaration(key).unit}"
    for key in (*dict.fromkeys(key for keys in OF_LAYOUT.values() for key in keys), *LIMITS)
}
"""The questions of this step, with what each asks."""
assert all(option(key).startswith("--") for key in OPTIONS)
