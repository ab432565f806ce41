"""Kinematics of a mecanum base: body velocity to wheel speeds. Pure."""

from __future__ import annotations

from math import pi


class Mecanum:
    """Wheel geometry; x forward, y left, wz counter-clockwise, motors 1 to 4 as the board numbers them.

    A wheel at rest is +0.0, never -0.0: the frame of four zeros is then the stop frame to the byte.
    """

    __slots__ = ("_lever_m", "_turns_per_m")

    def __init__(self, diameter_m: float, wheelbase_m: float, track_m: float) -> None:
        self._turns_per_m = 1 / (pi * diameter_m)
        self._lever_m = (wheelbase_m + track_m) / 2

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> tuple[float, float, float, float]:
        """Revolutions per second of motors 1 to 4; the right-hand motors are mounted the other way round."""
        turn = wz_radps * self._lever_m
        scale = self._turns_per_m
        return (
            (vx_mps - vy_mps - turn) * scale,
            (vx_mps + vy_mps - turn) * scale,
            (0.0 - vx_mps - vy_mps - turn) * scale,
            (0.0 - vx_mps + vy_mps - turn) * scale,
        )
