"""Scale: checks the setting board.per_rps, the scale of the wheels. This number is the speed, in the board's unit, at
which a wheel makes one turn per second. Until a person has confirmed the scale, the robot may only drive slowly. Pure.

If the scale is wrong, the robot drives too fast or too slowly. Measurements often don't show this, because commands and
reports use the same wrong scale. So the robot drives slowly until a person has watched a wheel turn. It is not enough
to write the number into the settings. failstop compares measured with commanded speeds only if the board uses different
units for commands and reports, or if a gyro measures how the robot turns.
"""

from __future__ import annotations

from math import isfinite

from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings

PER_RPS = "board.per_rps"
PER_RPS_CONFIRMED = "board.per_rps_confirmed"
"""The setting with the scale that a person has confirmed. The confirmation counts only if board.per_rps has the same
number."""
CAPS = {"limits.vx_mps": 0.05, "limits.vy_mps": 0.05, "limits.wz_radps": 0.25}
"""The highest speeds that are allowed while the scale is not confirmed. They are so low because the scale may be wrong.
Even if the scale is five times too large, the robot drives no faster than 0.25 m/s, the reduced speed at which people
may work beside a machine (ISO 10218-1)."""
ASSUMED = "nobody has confirmed the scale of the wheels (board.per_rps)"
REMEDY = "`failstop setup` confirms it by one turn of a wheel; without setup, see board.per_rps_confirmed"
WHEELS_FIT = {True: 1.25, False: 2.0}
"""By what factor the measured speed of a wheel may be above or below the commanded speed. The key is True for a board
that holds the commanded speed. It is False for a board that only sets a voltage, because its wheels turn faster
downhill and slower under load."""
GYRO_FITS = (1 / 1.6, 1.25)
"""The smallest and the largest allowed ratio of the robot's measured turn rate to the commanded one. The range is wider
below 1, because a robot with tracks or skidding wheels turns less than its wheels roll."""
FITS = 1.25
"""If a measured speed is above or below the commanded speed by more than this factor, people get a remark. The
difference may be harmless, because a slope, for example, can cause it."""
ON_A_STAND = 0.1
"""If the gyro measures less than this share of the commanded turn rate, it says nothing about the scale, because the
robot is probably on a stand, or somebody holds it."""


def capped(settings: Settings, *, assumed: bool) -> Settings:
    """The settings, with lower speed limits if nobody has confirmed the scale (`assumed`)."""
    if not assumed:
        return settings
    found = Settings.from_lines(settings.lines())
    for key, most in CAPS.items():
        found.values[key] = min(found[key], most)
    return found


def cap_text(settings: Settings) -> str:
    """A text for people that says that the speed is capped, and why. `settings`: what capped() has returned."""
    fastest = settings["limits.vx_mps"]
    return f"speed capped at {fastest:g} m/s, because {ASSUMED}; {REMEDY}"


def near(ratio: float, factor: float) -> bool:
    """True if `ratio` (measured divided by commanded) is between 1 / `factor` and `factor`."""
    return 1 / factor <= ratio <= factor


def wheels_differ(ratio: float, per_rps: float, *, holds_speed: bool) -> str:
    """A text for people if the wheels' measured speed shows that board.per_rps must be wrong, with the value that would
    fit. Empty if the difference may have a harmless reason, such as a slope. `ratio`: measured divided by commanded.
    `per_rps`: the present value, in the board's unit."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, WHEELS_FIT[holds_speed]):
        return ""
    return f"{_wheels(ratio)}: board.per_rps = {per_rps / ratio:.4g} would fit it (now {per_rps:.4g})"


def wheels_remark(ratio: float, per_rps: float) -> str:
    """A remark for people if the wheels' measured speed differs from the commanded speed, with possible harmless
    reasons. Empty if the difference is small. `ratio`: measured divided by commanded. `per_rps`: the present value of
    the setting board.per_rps."""
    if not (isfinite(ratio) and ratio > 0) or near(ratio, FITS):
        return ""
    would = f"board.per_rps = {per_rps / ratio:.4g} fits it (now {per_rps:.4g})"
    return f"{_wheels(ratio)}; a slope, a load or the battery can do that, but if they always do, {would}"


def _wheels(ratio: float) -> str:
    return f"the wheels turn {ratio:.2g} times as fast as they are told, as the board reports them"


def gyro_differs(ratio: float, layout: str) -> str:
    """A text for people if the gyro's turn rate shows that a setting is probably wrong, with the settings to check.
    Empty if the difference may come from tracks or skidding wheels, or if the robot hardly turns (see ON_A_STAND).
    `ratio`: measured divided by commanded."""
    least, most = GYRO_FITS
    if isfinite(ratio) and ratio <= -ON_A_STAND:
        return f"the robot turns the wrong way, as the gyro measures it: {_signs(layout)}, or the IMU is upside down"
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or least <= ratio <= most:
        return ""
    return f"{_turn(ratio)}: one of {_sizes(layout)} is not this robot's, or its wheels slip"


def gyro_remark(ratio: float, layout: str) -> str:
    """A remark for people if the gyro's turn rate differs from the commanded one, with possible harmless reasons. Empty
    if the difference is small, or if the robot hardly turns (see ON_A_STAND). `ratio`: measured divided by
    commanded."""
    if not (isfinite(ratio) and ratio >= ON_A_STAND) or near(ratio, FITS):
        return ""
    return f"{_turn(ratio)}; tracks and skidding wheels do that, but otherwise one of {_sizes(layout)} is wrong"


def _turn(ratio: float) -> str:
    return f"the robot turns {ratio:.2g} times as fast as it is told, as the gyro measures it"


def _signs(layout: str) -> str:
    """The settings that determine in which direction the robot turns, with what may be wrong."""
    if layout == ACKERMANN:
        return "steering.sign or a wheels.sign is wrong"
    return "its wheels are swapped (wheels.id_1, wheels.id_2, ...) or one of their signs is wrong (wheels.sign_1, ...)"


def _sizes(layout: str) -> str:
    """The settings that determine how fast the robot turns."""
    of_layout = {"omni3": "wheels.lever_m", ACKERMANN: "steering.per_rad, wheels.wheelbase_m"}
    return f"{of_layout.get(layout, 'wheels.track_m')}, wheels.diameter_m and board.per_rps"
