"""Sizes and limits: asks for the robot's sizes and speed limits. Then it shows how far the robot travels until it
stops."""

from __future__ import annotations

from collections.abc import Mapping

from failstop.api import distance
from failstop.cli import style
from failstop.policy.kinematics import AXES
from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings, declaration
from failstop.setup.talk import Talk, number, option

OF_LAYOUT = {
    "mecanum": ("wheels.diameter_m", "wheels.wheelbase_m", "wheels.track_m"),
    "differential": ("wheels.diameter_m", "wheels.track_m"),
    "omni3": ("wheels.diameter_m", "wheels.lever_m"),
    ACKERMANN: ("wheels.diameter_m", "wheels.wheelbase_m", "wheels.track_m"),
}
LIMITS = ("limits.vx_mps", "limits.vy_mps", "limits.wz_radps")


def answer_key(key: str) -> str:
    """Return the key of the question about a setting, for example `track_m` for `wheels.track_m`."""
    return key.partition(".")[2]


def step(talk: Talk, values: Mapping[str, object], *, known: bool) -> dict[str, object]:
    """Ask for the sizes and limits, as the fourth step of the setup. With `known`, the sizes in `values` are offered as
    answers. The limits are always offered. Raises Left."""
    talk.step(4, "Sizes and limits")
    if not known:
        talk.say("Measure the wheels, because failstop computes speeds and distances from their sizes.")
    settings = Settings(dict(values))
    chosen: dict[str, object] = {}
    layout = settings.text("wheels.layout")
    limits = [key for key in LIMITS if AXES[layout][1] or key != "limits.vy_mps"]
    explained = False
    for key in (*OF_LAYOUT[layout], *limits):
        offered = f"{settings[key]:g}" if known or key in limits else ""
        if offered and not explained and not talk.known(answer_key(key)):
            talk.say("Press Enter to accept the value in brackets.", style.DIM)
            explained = True
        chosen[key] = _number(talk, key, offered)
    for way in distance.sentences(Settings({**values, **chosen})):
        talk.say(way)
    return chosen


def _asked(key: str) -> str:
    """Return the question about a setting: the first sentence of the setting's description, then its unit."""
    declared = declaration(key)
    return f"{declared.doc.partition('. ')[0]}, {declared.unit}"


def _number(talk: Talk, key: str, offered: str) -> float:
    declared = declaration(key)
    assert declared.low is not None
    assert declared.high is not None
    words = _asked(key)
    words = f"{words[0].upper()}{words[1:]}"
    return float(talk.ask(answer_key(key), words, offered, number(declared.low, declared.high, declared.unit)))


OPTIONS = {
    answer_key(key): _asked(key)
    for key in (*dict.fromkeys(key for keys in OF_LAYOUT.values() for key in keys), *LIMITS)
}
"""The keys of the questions about sizes and limits, each with the help text of the command-line option that answers the
question."""
assert all(option(key).startswith("--") for key in OPTIONS)
