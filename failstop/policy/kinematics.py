"""Kinematics of a wheeled base: body velocity to wheel speeds, in each of the layouts there are. Pure.

Body velocity is x forward, y left, wz counter-clockwise. Wheels 1 and 2 are on the left, front and rear; 3 and 4 on the
right. Speeds come in the order of the ids on the wire, each with the sign of how its motor is mounted.

A wheel at rest is +0.0, never -0.0: the frame of four zeros is then the stop frame to the byte.
"""

from __future__ import annotations

from math import pi

from failstop.policy.settings import Settings

Velocity = tuple[float, float, float]  # vx, vy in m/s, wz in rad/s
WheelSpeeds = tuple[float, float, float, float]
Whole = tuple[int, ...]

# The right-hand motors are mounted the other way round.
SIGNS = (1, 1, -1, -1)
IDS = (0, 1, 2, 3)
WAYS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
"""How each wheel turns for a way to the left, and for a turn to the left; all go forward alike."""


class Chassis:
    """Four equal wheels. All of them follow vx and wz; mecanum wheels follow vy too."""

    __slots__ = ("_lever_m", "_turns_per_m", "_wheels", "axes")

    def __init__(self, diameter_m: float, lever_m: float, sideways: float, signs: Whole, ids: Whole) -> None:
        """`lever_m`: of each wheel about the middle; `sideways`: 1 when they follow vy, else 0."""
        self._turns_per_m = 1 / (pi * diameter_m)
        self._lever_m = lever_m
        self._wheels = [(signs[wheel] * self._turns_per_m, *WAYS[wheel]) for wheel in map(ids.index, IDS)]
        self.axes = (1.0, sideways, 1.0)
        """Factors of (vx, vy, wz) that the wheels can follow: a limit times its factor is the limit that holds."""

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> WheelSpeeds:
        """Revolutions per second by wire id. What no wheel can follow moves nothing."""
        turn, aside = wz_radps * self._lever_m, vy_mps * self.axes[1]
        # Adding zero makes +0.0 of -0.0.
        a, b, c, d = (
            (vx_mps + sideways * aside + about * turn) * turns_per_m + 0.0
            for turns_per_m, sideways, about in self._wheels
        )
        return a, b, c, d

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The fastest that any wheel can turn within these limits (each at least 0)."""
        return (vx_mps + vy_mps * self.axes[1] + wz_radps * self._lever_m) * self._turns_per_m


def mecanum(diameter_m: float, wheelbase_m: float, track_m: float, signs: Whole = SIGNS, ids: Whole = IDS) -> Chassis:
    """Four mecanum wheels: moves along x and y and turns."""
    return Chassis(diameter_m, (wheelbase_m + track_m) / 2, 1.0, signs, ids)


def differential(diameter_m: float, track_m: float, signs: Whole = SIGNS, ids: Whole = IDS) -> Chassis:
    """Fixed wheels on two sides, two each: moves along x and turns. The turn is that of a base which pivots between its
    wheels; one that skids turns less, and is given a wider track."""
    return Chassis(diameter_m, track_m / 2, 0.0, signs, ids)


def from_settings(settings: Settings) -> Chassis:
    """The kinematics that wheels.layout names, with the sizes, signs and ids of [wheels]. Raises ValueError."""
    signs, ids = (tuple(int(settings[f"wheels.{what}_{wheel}"]) for wheel in (1, 2, 3, 4)) for what in ("sign", "id"))
    diameter_m, track_m = settings["wheels.diameter_m"], settings["wheels.track_m"]
    layout = settings.text("wheels.layout")
    if layout == "mecanum":
        return mecanum(diameter_m, settings["wheels.wheelbase_m"], track_m, signs, ids)
    if layout == "differential":
        return differential(diameter_m, track_m, signs, ids)
    raise ValueError(f"wheels.layout = {layout!r}: it has no kinematics")


def max_wheel_rps(settings: Settings) -> float:
    """The fastest that any wheel can turn within the settings' limits, in revolutions per second."""
    return from_settings(settings).worst_rps(*(settings[f"limits.{axis}"] for axis in ("vx_mps", "vy_mps", "wz_radps")))
