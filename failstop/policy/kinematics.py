"""Kinematics of a wheeled base: from body velocity to wheel speeds and back, for each layout. Pure.

Body velocity is x forward, y left, wz counter-clockwise. Speeds come in the order of the ids on the wire, each with the
sign of how its motor is mounted. On a base with two sides, wheels are numbered left before right, and front before
rear. A wheel at rest is +0.0, never -0.0, so that the frame of zeros equals the stop frame byte for byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, copysign, cos, pi, radians, sin, tan
from operator import mul

from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings, mounted_wheels

Velocity = tuple[float, float, float]  # vx, vy in m/s, wz in rad/s
WheelSpeeds = tuple[float, ...]
RimSpeeds = tuple[float, float, float]
"""The speed at a wheel's rim, m/s, for each m/s of vx and vy and each rad/s of wz."""

FIXED, MECANUM = 0.0, 1.0
"""How much the wheels of a base with two sides follow vy. FIXED wheels don't."""
AXES = {
    "mecanum": (1.0, 1.0, 1.0),
    "differential": (1.0, 0.0, 1.0),
    "omni3": (1.0, 1.0, 1.0),
    ACKERMANN: (1.0, 0.0, 1.0),
}
"""Which of (vx, vy, wz) a base with each layout can follow, as factors. A limit times its factor is the limit that
applies."""


LEAST_PIVOT = 1e-9
"""A number that is smaller than this share of the largest one counts as a rounding error."""


class Chassis:
    """Wheels of one diameter. Each turns in proportion to the velocity of the base."""

    __slots__ = ("_back", "_rows", "axes", "rest")
    steers = False
    """True if the last of the speeds is the angle of the steered wheels, rad to the left."""

    def __init__(
        self,
        axes: Velocity,
        rows: Sequence[RimSpeeds],
        diameter_m: float,
        mounted: Sequence[tuple[int, int]],
        speeds: int,
    ) -> None:
        """`rows`: one for each wheel; `mounted`: the id on the wire and the sign of each; `speeds`: how many are sent.
        An id without a wheel gets zero."""
        self.axes = axes
        self.rest = (0.0,) * speeds
        turns_per_m = 1 / (pi * diameter_m)
        by_id = {
            id_: tuple(sign * turns_per_m * rim for rim in row) for row, (id_, sign) in zip(rows, mounted, strict=True)
        }
        self._rows = [by_id.get(id_, (0.0, 0.0, 0.0)) for id_ in range(speeds)]
        self._back: tuple[tuple[float, ...], ...] | None = None

    def rolled(self) -> tuple[tuple[float, ...], ...]:
        """The inverse: for each of vx, vy (m/s) and wz (rad/s), the factor of each wheel's turns per second, by wire
        id.

        The product is the velocity that fits all wheels best (least squares). Four mecanum wheels have one speed more
        than the body has directions, so the part that they can't roll together is slip. Raises ValueError if the wheels
        can't tell the directions apart, for example three omni wheels that all roll the same way.
        """
        if self._back is None:
            self._back = _least_squares(self._rows, self.axes)
        return self._back

    def velocity(self, rps: Sequence[float]) -> Velocity:
        """The body's velocity (m/s, m/s, rad/s) at these wheel speeds, in revolutions per second by wire id. Raises
        ValueError as rolled() does."""
        vx, vy, wz = [sum(map(mul, row, rps)) for row in self.rolled()]
        return vx, vy, wz

    def reach(self, velocity: Velocity) -> Velocity:
        """The closest velocity that the base can have."""
        return velocity

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> WheelSpeeds:
        """The speed of each wheel by wire id, turns per second. A velocity that no wheel can follow moves nothing."""
        # Adding zero turns -0.0 into +0.0.
        return tuple([x * vx_mps + y * vy_mps + z * wz_radps + 0.0 for x, y, z in self._rows])

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The highest speed that any wheel can reach within these limits (each at least 0), turns per second."""
        return max(abs(x) * vx_mps + abs(y) * vy_mps + abs(z) * wz_radps for x, y, z in self._rows)


class Steered(Chassis):
    """One or two driven wheels at the rear, and a steered axle in front (Ackermann): it turns only while it drives. One
    wheel stands for an axle with a differential gear."""

    __slots__ = ("_most_rad", "_rear", "_turns_most", "_wheelbase_m")
    steers = True

    def __init__(self, rear: Chassis, wheelbase_m: float, most_rad: float) -> None:
        """`rear`: the driven wheels; `most_rad`: the largest steering angle."""
        self._rear, self._wheelbase_m, self._most_rad = rear, wheelbase_m, most_rad
        self._turns_most = tan(most_rad) / wheelbase_m
        self.axes, self.rest = AXES[ACKERMANN], (*rear.rest, 0.0)

    def reach(self, velocity: Velocity) -> Velocity:
        """The closest velocity that it can have at this forward speed: no curve is tighter than its steering allows."""
        vx, _, wz = velocity
        most = abs(vx) * self._turns_most
        return vx, 0.0, max(-most, min(most, wz))

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> WheelSpeeds:
        """The speed of each wheel by wire id, turns per second, and then the angle of the steered wheels, rad. At rest
        the angle is 0, because a velocity of zero does not determine it."""
        vx, vy, wz = self.reach((vx_mps, vy_mps, wz_radps))
        angle = atan2(self._wheelbase_m * abs(wz), abs(vx)) if vx and wz else 0.0
        # For the smallest numbers, the quotient is rounded to a larger angle than the curve's.
        return *self._rear.wheels_rps(vx, vy, wz), copysign(min(angle, self._most_rad), vx * wz) if angle else 0.0

    @property
    def turns_unseen(self) -> bool:
        """True if only the commanded angle shows how the base turns, because it has one driven wheel."""
        return len(self._rear.rest) == 1

    def rolled(self) -> tuple[tuple[float, ...], ...]:
        """From the two rear wheels: the difference of their speeds gives the turn, whatever the steering angle is by
        then. One wheel gives no turn."""
        return self._rear.rolled()

    def turn_radps(self, vx_mps: float, steering_rad: float) -> float:
        """How fast the base turns at this steering angle (positive to the left), rad/s."""
        return vx_mps * tan(max(-self._most_rad, min(steering_rad, self._most_rad))) / self._wheelbase_m

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The speed of the fastest wheel: the outer one in the tightest curve."""
        return self._rear.worst_rps(*self.reach((vx_mps, vy_mps, wz_radps)))


def _least_squares(rows: Sequence[Sequence[float]], axes: Velocity) -> tuple[tuple[float, ...], ...]:
    """The pseudo-inverse of rows of three numbers, leaving out directions whose factor in `axes` is 0."""
    used = [at for at in range(3) if axes[at]]
    # Gauss-Jordan elimination on the normal equations, with the wheels on the right side.
    table = [[sum(row[a] * row[b] for row in rows) for b in used] + [row[a] for row in rows] for a in used]
    least = LEAST_PIVOT * max(abs(value) for line in table for value in line[: len(used)])
    for at, _ in enumerate(used):
        best = max(range(at, len(used)), key=lambda line: abs(table[line][at]))
        table[at], table[best] = table[best], table[at]
        pivot = table[at][at]
        if abs(pivot) <= least:
            raise ValueError("these wheels can't tell the directions of the base apart")
        table[at] = [value / pivot for value in table[at]]
        for line, values in enumerate(table):
            if line != at and (share := values[at]):
                table[line] = [value - share * own for value, own in zip(values, table[at], strict=True)]
    found = {axis: tuple(line[len(used) :]) for axis, line in zip(used, table, strict=True)}
    nothing = (0.0,) * len(rows)
    return tuple(found.get(at, nothing) for at in range(3))


def two_sides(wheels: int, lever_m: float, sideways: float) -> list[RimSpeeds]:
    """Wheels on a left and a right side, two or four. `lever_m`: the lever of each about the middle; `sideways`: how
    much it follows vy. To move left, the front left and the rear right mecanum wheel turn backward."""
    sides = (-1.0, 1.0) if wheels == 2 else (-1.0, -1.0, 1.0, 1.0)
    return [(1.0, (side if number % 2 == 0 else -side) * sideways, side * lever_m) for number, side in enumerate(sides)]


def omni(lever_m: float, ways_deg: Sequence[float]) -> list[RimSpeeds]:
    """Omni wheels around the middle of the base. Each rolls in one direction, given in degrees counter-clockwise from
    forward, and slips across it. If all roll forward, the robot turns counter-clockwise."""
    # Rounded, so that a wheel at right angles to the motion does not turn.
    return [(round(cos(radians(way)), 15), round(sin(radians(way)), 15), lever_m) for way in ways_deg]


def from_settings(settings: Settings) -> Chassis:
    """The kinematics for wheels.layout, with the sizes, signs and ids of [wheels]."""
    layout, mounted = settings.text("wheels.layout"), mounted_wheels(settings.values)
    if layout == "omni3":
        rows = omni(settings["wheels.lever_m"], [settings[f"wheels.angle_{number}_deg"] for number in (1, 2, 3)])
    elif layout == "mecanum":
        rows = two_sides(len(mounted), (settings["wheels.wheelbase_m"] + settings["wheels.track_m"]) / 2, MECANUM)
    elif layout == "differential":
        # A base that skids turns less than one that pivots between its wheels, so its track is set wider.
        rows = two_sides(len(mounted), settings["wheels.track_m"] / 2, FIXED)
    elif layout == ACKERMANN:
        rows = two_sides(len(mounted), settings["wheels.track_m"] / 2, FIXED)
        axes = AXES[layout]
        if len(mounted) == 1:
            rows, axes = [(1.0, 0.0, 0.0)], (1.0, 0.0, 0.0)
        rear = Chassis(axes, rows, settings["wheels.diameter_m"], mounted, settings.speeds)
        return Steered(rear, settings["wheels.wheelbase_m"], radians(settings["steering.most_deg"]))
    else:
        raise ValueError(f"wheels.layout = {layout!r}: it has no kinematics")
    return Chassis(AXES[layout], rows, settings["wheels.diameter_m"], mounted, settings.speeds)


def of_wheels(
    base: Chassis, mounted: Sequence[tuple[int, int]], speeds_radps: Sequence[float], steering_rad: float | None = None
) -> Velocity:
    """The body's velocity at these wheel speeds (rad/s, positive forward, in the order of the wheels' numbers).
    `mounted`: as settings.mounted_wheels returns it; `steering_rad`: the steering angle, positive to the left; with it,
    the rear wheels only give the speed. Raises ValueError."""
    rps = [0.0] * len(base.rest)
    for (id_, sign), speed in zip(mounted, speeds_radps, strict=True):
        rps[id_] = sign * speed / (2 * pi)
    vx, vy, wz = base.velocity(rps)
    if steering_rad is None:
        return vx, vy, wz
    if not isinstance(base, Steered):
        raise ValueError("this base is not steered")
    return vx, vy, base.turn_radps(vx, steering_rad)


def max_wheel_rps(settings: Settings) -> float:
    """The highest speed that any wheel can reach within the settings' limits, turns per second."""
    return from_settings(settings).worst_rps(*(settings[f"limits.{axis}"] for axis in ("vx_mps", "vy_mps", "wz_radps")))
