"""Sizes and limits: asks for the robot's sizes and speed limits. Then it shows how far the robot travels until it
stops."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor

from failstop.api import distance
from failstop.board.kinds import board_of
from failstop.cli import style
from failstop.policy.kinematics import AXES, max_wheel_rps
from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings, declaration
from failstop.setup.talk import Left, Talk, number, option
from failstop.supervisor.fit import wrong_limits

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
    answers. The limits are always offered, and asked again if the board can't turn the wheels so fast or so slowly.
    Raises Left."""
    talk.step(4, "Sizes and limits")
    if not known:
        talk.say("Measure the wheels, because failstop computes speeds and distances from their sizes.")
    settings = Settings(dict(values))
    chosen: dict[str, object] = {}
    layout = settings.text("wheels.layout")
    limits = [key for key in LIMITS if AXES[layout][1] or key != "limits.vy_mps"]
    explained = False
    left = [*OF_LAYOUT[layout], *limits]
    possible: dict[str, float] = {}
    while left:
        key = left.pop(0)
        if key in limits and not possible:
            possible = _possible(Settings({**values, **chosen}), limits)
        offered = f"{possible.get(key, settings[key]):g}" if known or key in limits else ""
        if offered and not explained and not talk.known(answer_key(key)):
            talk.say("Press Enter to accept the value in brackets.", style.DIM)
            explained = True
        chosen[key] = _number(talk, key, offered)
        if not left and (wrong := _wrong(Settings({**values, **chosen}))):
            talk.draft.forget(*map(answer_key, limits))
            if talk.silent:
                raise Left(wrong)
            talk.warn(f"{wrong[0].upper()}{wrong[1:]}.", "type the limits again")
            left = list(limits)
    for way in distance.sentences(Settings({**values, **chosen})):
        talk.say(way)
    return chosen


def _possible(settings: Settings, limits: list[str]) -> dict[str, float]:
    """Return the values of these limits that setup offers: those in the settings, all lowered by the same factor if the
    board can't turn the wheels so fast."""
    share = board_of(*settings.board()).most_rps / max_wheel_rps(settings)
    return {key: settings[key] if share >= 1 else floor(1000 * share * settings[key]) / 1000 for key in limits}


def _wrong(settings: Settings) -> str:
    """Return why the service would not start with these limits, or "" if it would."""
    return wrong_limits(settings, board_of(*settings.board()))


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
