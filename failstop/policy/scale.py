"""Scale: how many of the board's speed units make one wheel turn per second (the setting board.per_rps), and how slowly
the robot drives until a person has confirmed that number. Pure.

If commands and reports use the same scale, they always agree, even if the scale is wrong, and only a person who sees
the wheel can tell. So the robot drives slowly until a person has watched a wheel turn; writing the number into the
settings does not count. If the board reports in another unit, or a gyro feels the turn, failstop compares the measured
speed with the commanded one.
"""

from __future__ import annotations

from math import isfinite

from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings

PER_RPS = "board.per_rps"
PER_RPS_CONFIRMED = "board.per_rps_confirmed"
"""The confirmed number. It counts only for the same number in PER_RPS."""
CAPS = {"limits.vx_mps": 0.05, "limits.vy_mps": 0.05, "limits.wz_radps": 0.25}
"""Speeds that an unconfirmed scale allows at most. A scale that is five times too large makes 0.25 m/s of 0.05: the
reduced speed at which people may work beside a machine (ISO 10218-1)."""
ASSUMED = "nobody has confirmed the scale of the wheels (board.per_rps)"
REMEDY = "`failstop setup` confirms it by one turn of a wheel; without setup, see board.per_rps_confirmed"
WHEELS_FIT = {True: 1.25, False: 2.0}
"""How far the measured speed of a wheel may differ from the commanded one, up or down, as a factor. Two values: for a
board that holds the commanded speed, and for one that sets a voltage, whose wheels are faster downhill and slower under
load."""
GYRO_FITS = (1 / 1.6, 1.25)
"""How far the measured turn rate of the robot may differ from the commanded one: the smallest and the largest factor.
The range is wider below 1, because tracks and skidding wheels turn the robot less than they roll."""
FITS = 1.25
"""If a speed differs by more than this factor, people get a remark, even if a healthy robot may explain it."""
ON_A_STAND = 0.1
"""If the gyro feels less than this share of the turn, it says nothing about the scale, because the robot is on a stand
or held."""


def capped(settings: Settings, *, assumed: bool) -> Settings:
    """The settings with the limits that hold: lower ones while the scale is `assumed`."""
    if not assumed:
        return settings
    found = Settings.from_lines(settings.lines())
    for key, most in CAPS.items():
        found.values[key] = min(found[key], most)
    return found


def cap_text(settings: Settings) -> str:
    """What an unconfirmed scale means for driving, in words. `settings`: those of the run, with the cap in them."""
    fastest = settings["limits.vx_mps"]
    return f"speed capped at {fastest:g} m/s, because {ASSUMED}; {REMEDY}"


def near(ratio: float, factor: float) -> bool:
    """True if measured divided by commanded is within this factor, up or down."""
    return 1 / factor <= ratio <= factor


def wheels_differ(ratio: float, per_rps: float, *, holds_speed: bool) -> str:
    """The text about wheels that turn at `ratio` times the commanded speed, with the value of board.per_rps that would
    fit; empty if the difference can be explained. `per_rps`: the value in use, in the board's unit."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, WHEELS_FIT[holds_speed]):
        return ""
    return f"{_wheels(ratio)}: board.per_rps = {per_rps / ratio:.4g} would fit it (now {per_rps:.4g})"


def wheels_remark(ratio: float, per_rps: float) -> str:
    """A remark for people about wheels that turn at `ratio` times the commanded speed, when that may also have a
    harmless reason, such as a slope; empty if the difference is small. `per_rps`: the value in use, in the board's
    unit."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, FITS):
        return ""
    would = f"board.per_rps = {per_rps / ratio:.4g} fits it (now {per_rps:.4g})"
    return f"{_wheels(ratio)}; a slope, a load or the battery can do that, but if they always do, {would}"


def _wheels(ratio: float) -> str:
    return f"the wheels turn {ratio:.2g} times as fast as they are told, as the board reports them"


def gyro_differs(ratio: float, layout: str) -> str:
    """The text about a robot that turns `ratio` times as fast as commanded, as its gyro measures it, and about the
    settings that may be wrong; empty if the difference can be explained."""
    least, most = GYRO_FITS
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or least <= ratio <= most:
        return ""
    return f"{_turn(ratio)}: one of {_sizes(layout)} is not this robot's, or its wheels slip"


def gyro_remark(ratio: float, layout: str) -> str:
    """A remark for people about a robot that turns `ratio` times as fast as commanded, when skidding tracks or wheels
    may also explain it; empty if the difference is small."""
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or near(ratio, FITS):
        return ""
    return f"{_turn(ratio)}; tracks and skidding wheels do that, but otherwise one of {_sizes(layout)} is wrong"


def _turn(ratio: float) -> str:
    return f"the robot turns {ratio:.2g} times as fast as it is told, as the gyro measures it"


def _sizes(layout: str) -> str:
    """The settings that determine how fast the robot turns."""
    of_layout = {"omni3": "wheels.lever_m", ACKERMANN: "steering.per_rad, wheels.wheelbase_m"}
    return f"{of_layout.get(layout, 'wheels.track_m')}, wheels.diameter_m and board.per_rps"
