"""Robots: the robots of Hiwonder's RRC family, with the default settings of each. Pure.

The default settings, such as the size of the wheels, come from each robot's own ROS 2 packages (controller:
odom_publisher_node.py, mecanum.py, ackermann.py). A default is None if no source has the value, or if two sources
disagree. You must measure such a value on your robot.
"""

from __future__ import annotations

from math import pi, radians

from failstop.policy.setting import SettingError

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection

    Defaults = dict[str, float | str | None]

USUAL_ROBOT = "rosorin"
SIZES = ("wheels.diameter_m", "wheels.wheelbase_m", "wheels.track_m")


def _sizes(*sizes_m: float) -> Defaults:
    return dict(zip(SIZES, sizes_m, strict=True))


def _signs(*signs: int) -> Defaults:
    return {f"wheels.sign_{number}": sign for number, sign in enumerate(signs, 1)}


def _steering(per_rad: float, sign: int | None, most_deg: float) -> Defaults:
    return {"steering.per_rad": per_rad, "steering.sign": sign, "steering.most_deg": most_deg}


LEFT_BACKWARD = _signs(-1, -1, 1, 1)
"""The signs for robots with all motors mounted the other way round than ROSOrin's."""
MENTORPI = _sizes(0.065, 0.1368, 0.1446) | LEFT_BACKWARD
ROBOTS: dict[str, dict[str, Defaults]] = {
    USUAL_ROBOT: {
        "mecanum": _sizes(0.08, 0.17706, 0.17165),
        "differential": _sizes(0.08, 0.17706, 0.17165),
        "ackermann": _sizes(0.085, 0.17706, 0.17165) | _steering(2000 / pi, -1, 34.0),
        "omni3": {},
    },
    # Sources disagree about the direction of its steering servo (29 degrees to one side, 40 to the other).
    "mentorpi": {"mecanum": MENTORPI, "ackermann": _sizes(0.067, 0.145, 0.133) | _steering(2000 / pi, None, 29.0)},
    "landerpi": {
        "mecanum": MENTORPI,
        # Its tracks skid, so they turn the robot as mecanum wheels on a base of this size would.
        "differential": _sizes(0.068, 0.1368, 0.1368 + 0.1446) | LEFT_BACKWARD,
        "ackermann": _sizes(0.067, 0.145, 0.133) | _signs(-1, 1) | _steering(1000 / pi, 1, 40.0),
    },
    # Sources disagree about its sizes (a track of 0.182, 0.195 or 0.222 m). Bus servo 9, with 240 degrees, steers it.
    "jetacker": {
        "ackermann": dict.fromkeys(SIZES)
        | _steering(1000 / radians(240), 1, 37.0)
        | {"steering.kind": "bus", "steering.servo": 9, "steering.centre": 500}
    },
    "jetrover": {"mecanum": _sizes(0.097, 0.216, 0.195)},
}
UNDRIVEN = {
    "turbopi": "its own program sets duties, never speeds: after a stop of speeds a motor without an encoder goes on "
    "turning; where its motors have encoders, leave this name out and set device.path and [wheels]",
}
"""Robots of Hiwonder's RRC family that failstop can't drive, each with the reason."""
LAYOUT_OF = {"jetacker": "ackermann"}
"""The default layout of each robot that does not exist with mecanum wheels."""


EVERY_ROBOT = (*ROBOTS, *UNDRIVEN)


def fill_figures(values: dict[str, float | str], changed: Collection[str]) -> None:
    """Fill in the defaults of the robot that the settings name, for every setting that the user has not set. Raises
    SettingError if failstop can't drive that robot, or if the user must measure and set a value that has no default."""
    robot, layout = str(values["board.robot"]), str(values["wheels.layout"])
    if robot in UNDRIVEN:
        raise SettingError(f'board.robot = "{robot}": {UNDRIVEN[robot]}')
    # For a base with two sides, the width counts but the length does not.
    sizes = [key for key in SIZES if (layout, key) != ("differential", "wheels.wheelbase_m")]
    known = ROBOTS[robot].get(layout, dict.fromkeys(sizes))
    missing = [key for key, value in known.items() if value is None and key in values and key not in changed]
    if missing:
        whose = f'board.robot "{robot}" with wheels.layout "{layout}"'
        raise SettingError(f"{', '.join(missing)}: no source has this of {whose}; measure it, and set it")
    values |= {key: value for key, value in known.items() if value is not None and key in values and key not in changed}
