"""Scale: how much of the board's unit is one turn a second of a wheel (the setting board.per_rps), and what holds until
a person has confirmed it. Pure.

Where commands and reports share the scale, their ratio is 1 whatever it is: only a person, who sees the wheel, can tell
that it is wrong. So a robot whose scale nobody has confirmed drives slowly, and a number that a person has only written
into the settings confirms nothing. Where the board reports in a unit of its
own, or a gyro feels the turn, what was measured is compared with what was told.
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
"""The same for a turn of the robot, as the least and the largest factor. Tracks and skidding wheels turn the robot less
than they roll, but nothing turns it more."""
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
    """The text about wheels that turn at `ratio` times the commanded speed, and about the setting; empty if it fits.
    `per_rps`: the value in use, in the board's unit."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, WHEELS_FIT[holds_speed]):
        return ""
    return f"{_wheels(ratio)}: board.per_rps = {per_rps / ratio:.4g} would fit it (now {per_rps:.4g})"


def wheels_remark(ratio: float, per_rps: float) -> str:
    """The same if a healthy robot may explain it, because its board sets a voltage; empty if it fits."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, FITS):
        return ""
    would = f"board.per_rps = {per_rps / ratio:.4g} fits it (now {per_rps:.4g})"
    return f"{_wheels(ratio)}; a slope, a load or the battery can do that, but if they always do, {would}"


def _wheels(ratio: float) -> str:
    return f"the wheels turn {ratio:.2g} times as fast as they are told, as the board reports them"


def gyro_differs(ratio: float, layout: str) -> str:
    """The same for a robot whose gyro feels `ratio` times the commanded turn."""
    least, most = GYRO_FITS
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or least <= ratio <= most:
        return ""
    return f"{_turn(ratio)}: one of {_sizes(layout)} is not this robot's, or its wheels slip"


def gyro_remark(ratio: float, layout: str) -> str:
    """The same if a healthy robot may explain it, because its tracks or wheels skid; empty if it fits."""
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or near(ratio, FITS):
        return ""
    return f"{_turn(ratio)}; tracks and skidding wheels do that, but otherwise one of {_sizes(layout)} is wrong"


def _turn(ratio: float) -> str:
    return f"the robot turns {ratio:.2g} times as fast as it is told, as the gyro measures it"


def _sizes(layout: str) -> str:
    """The settings that determine how fast the robot turns."""
    of_layout = {"omni3": "wheels.lever_m", ACKERMANN: "steering.per_rad, wheels.wheelbase_m"}
    return f"{of_layout.get(layout, 'wheels.track_m')}, wheels.diameter_m and board.per_rps"
