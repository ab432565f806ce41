"""Keys: turns the keys of LeKiwi's keyboard control into velocities of the base. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

KEYS = {
    "forward": "w",
    "backward": "s",
    "left": "a",
    "right": "d",
    "rotate_left": "z",
    "rotate_right": "x",
    "speed_up": "r",
    "speed_down": "f",
    "quit": "q",
}
LEVELS = ((0.1, 30.0), (0.2, 60.0), (0.3, 90.0))
"""The speeds to choose from: m/s for driving, deg/s for turning."""
AXES = (("x.vel", "forward", "backward"), ("y.vel", "left", "right"), ("theta.vel", "rotate_left", "rotate_right"))


def level_after(level: int, pressed: Collection[str], keys: Mapping[str, str]) -> int:
    """The new index into LEVELS, after these keys were pressed."""
    if keys["speed_up"] in pressed:
        level = min(level + 1, len(LEVELS) - 1)
    if keys["speed_down"] in pressed:
        level = max(level - 1, 0)
    return level


def velocity(level: int, pressed: Collection[str], keys: Mapping[str, str]) -> dict[str, float]:
    """The velocity for the keys that are pressed: x.vel and y.vel in m/s, and theta.vel in deg/s."""
    along, around = LEVELS[level]
    speeds = {"x.vel": along, "y.vel": along, "theta.vel": around}
    return {axis: speeds[axis] * ((keys[plus] in pressed) - (keys[minus] in pressed)) for axis, plus, minus in AXES}
