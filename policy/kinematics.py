"""Kinematics of a wheeled base: body velocity to wheel speeds, in each of the layouts there are. Pure.

Body velocity is x forward, y left, wz counter-clockwise. Wheels 1 and 2 are on the left, front and rear; 3 and 4 on the
right. Speeds come in the order of the ids on the wire, each with the sign of how its motor is mounted.

A wheel at rest is +0.0, never -0.0: the frame of four zeros is then the stop frame to the byte.
"""

from __future__ import annotations

from math import pi

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings

    Four = tuple[float, float, float, float]

# The right-hand motors are mounted the other way round.
SIGNS = (1, 1, -1, -1)
IDS = (0, 1, 2, 3)


class _Wheels:
    """Mounting of four equal wheels: metres at the rim to revolutions, sign and place of each."""

    __slots__ = ("_a", "_b", "_c", "_d", "_order", "_turns_per_m")

    def __init__(self, diameter_m: float, signs: tuple[int, int, int, int], ids: tuple[int, int, int, int]) -> None:
        turns_per_m = 1 / (pi * diameter_m)
        self._turns_per_m = turns_per_m
        self._a, self._b, self._c, self._d = (sign * turns_per_m for sign in signs)
        # Wheel whose speed goes to each wire id.
        self._order = tuple(ids.index(wire_id) for wire_id in IDS)

    def _mounted(self, a_mps: float, b_mps: float, c_mps: float, d_mps: float) -> Four:
        # Adding zero makes +0.0 of -0.0.
        speeds = (a_mps * self._a + 0.0, b_mps * self._b + 0.0, c_mps * self._c + 0.0, d_mps * self._d + 0.0)
        a, b, c, d = self._order
        return speeds[a], speeds[b], speeds[c], speeds[d]


class Mecanum(_Wheels):
    """Four mecanum wheels: moves along x and y and turns."""

    __slots__ = ("_lever_m",)

    axes = (1.0, 1.0, 1.0)
    """What it can follow of (vx, vy, wz): a limit times this is the limit that holds."""

    def __init__(
        self,
        diameter_m: float,
        wheelbase_m: float,
        track_m: float,
        signs: tuple[int, int, int, int] = SIGNS,
        ids: tuple[int, int, int, int] = IDS,
    ) -> None:
        super().__init__(diameter_m, signs, ids)
        self._lever_m = (wheelbase_m + track_m) / 2

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> Four:
        """Revolutions per second by wire id."""
        turn = wz_radps * self._lever_m
        return self._mounted(
            vx_mps - vy_mps - turn, vx_mps + vy_mps - turn, vx_mps + vy_mps + turn, vx_mps - vy_mps + turn
        )

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The fastest that any wheel can turn within these limits (each at least 0)."""
        return (vx_mps + vy_mps + wz_radps * self._lever_m) * self._turns_per_m


class Differential(_Wheels):
    """Fixed wheels on two sides, two each: moves along x and turns.

    The turn is that of a base which pivots between its wheels; one that skids turns less, and is given a wider track.
    """

    __slots__ = ("_lever_m",)

    axes = (1.0, 0.0, 1.0)
    """What it can follow of (vx, vy, wz): a limit times this is the limit that holds."""

    def __init__(
        self,
        diameter_m: float,
        track_m: float,
        signs: tuple[int, int, int, int] = SIGNS,
        ids: tuple[int, int, int, int] = IDS,
    ) -> None:
        super().__init__(diameter_m, signs, ids)
        self._lever_m = track_m / 2

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> Four:
        """Revolutions per second by wire id. No wheel can follow vy_mps: it moves nothing."""
        turn = wz_radps * self._lever_m
        left, right = vx_mps - turn, vx_mps + turn
        return self._mounted(left, left, right, right)

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The fastest that any wheel can turn within these limits (each at least 0)."""
        return (vx_mps + wz_radps * self._lever_m) * self._turns_per_m


def from_settings(settings: Settings) -> Mecanum | Differential:
    """The kinematics that wheels.layout names, with the sizes, signs and ids of [wheels]. Raises ValueError."""
    signs = _whole(settings, "sign")
    ids = _whole(settings, "id")
    diameter_m, track_m = settings["wheels.diameter_m"], settings["wheels.track_m"]
    layout = settings.text("wheels.layout")
    if layout == "mecanum":
        return Mecanum(diameter_m, settings["wheels.wheelbase_m"], track_m, signs, ids)
    if layout == "differential":
        return Differential(diameter_m, track_m, signs, ids)
    raise ValueError(f"wheels.layout = {layout!r}: it has no kinematics")


def _whole(settings: Settings, what: str) -> tuple[int, int, int, int]:
    first, second, third, fourth = (int(settings[f"wheels.{what}_{wheel}"]) for wheel in (1, 2, 3, 4))
    return first, second, third, fourth
