"""Kinematics of a wheeled base: converts the velocity of the body to wheel speeds and back, for each layout. Pure.

The body's velocity is x forward, y left, wz counter-clockwise. Wheel speeds are in the order of the ids on the wire,
and their sign depends on how each motor is mounted. Four wheels are numbered in the order front left, rear left, front
right, rear right, and two wheels in the order left, right. A wheel at rest has the speed +0.0, never -0.0, so that a
frame of zeros has the same bytes as the stop frame.
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
"""Three factors for one wheel: what 1 m/s of vx, 1 m/s of vy and 1 rad/s of wz each add to the speed of the wheel's
rim, in m/s."""

FIXED, MECANUM = 0.0, 1.0
"""How fast wheels of this type turn in a sideways motion, compared with a forward motion of the same speed. FIXED
wheels don't turn."""
AXES = {
    "mecanum": (1.0, 1.0, 1.0),
    "differential": (1.0, 0.0, 1.0),
    "omni3": (1.0, 1.0, 1.0),
    ACKERMANN: (1.0, 0.0, 1.0),
}
"""For each layout, which of vx, vy and wz the base can follow: 1 if it can, 0 if not. The speed limit for each
direction is multiplied by this number, so that it is 0 for a direction in which the base can't move."""


LEAST_PIVOT = 1e-9
"""Numbers below this share of a matrix's largest number are taken for rounding errors."""


class Chassis:
    """A base whose wheels all have the same diameter, and turn in proportion to the velocity of the base."""

    __slots__ = ("_back", "_rows", "axes", "rest")
    steers = False
    """True if the last number in a frame of wheel speeds is not a speed, but the angle of the steered wheels in rad,
    which is positive to the left."""

    def __init__(
        self,
        axes: Velocity,
        rows: Sequence[RimSpeeds],
        diameter_m: float,
        mounted: Sequence[tuple[int, int]],
        speeds: int,
    ) -> None:
        """`rows`: the rim speeds of each wheel. `mounted`: the id on the wire and the sign of each wheel. `speeds`: how
        many speeds a frame has. An id without a wheel always gets the speed zero."""
        self.axes = axes
        self.rest = (0.0,) * speeds
        turns_per_m = 1 / (pi * diameter_m)
        by_id = {
            id_: tuple(sign * turns_per_m * rim for rim in row) for row, (id_, sign) in zip(rows, mounted, strict=True)
        }
        self._rows = [by_id.get(id_, (0.0, 0.0, 0.0)) for id_ in range(speeds)]
        self._back: tuple[tuple[float, ...], ...] | None = None

    def rolled(self) -> tuple[tuple[float, ...], ...]:
        """The matrix that converts wheel speeds (turns per second, by wire id) to the body's velocity. Its rows are for
        vx (m/s), vy (m/s) and wz (rad/s), with one factor for each id on the wire.

        If no velocity fits the speeds of all wheels, some wheels slip. The result is then the velocity that fits best
        (least squares). Raises ValueError if several velocities give the same wheel speeds, for example because three
        omni wheels all roll in the same direction.
        """
        if self._back is None:
            self._back = _least_squares(self._rows, self.axes)
        return self._back

    def velocity(self, rps: Sequence[float]) -> Velocity:
        """The body's velocity (m/s, m/s, rad/s) at these wheel speeds, in turns per second by wire id. Raises
        ValueError if several velocities of the body give the same wheel speeds."""
        vx, vy, wz = [sum(map(mul, row, rps)) for row in self.rolled()]
        return vx, vy, wz

    def reach(self, velocity: Velocity) -> Velocity:
        """`velocity`, limited to what the base can do. Only Steered limits anything."""
        return velocity

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> WheelSpeeds:
        """The speed of each wheel for this velocity, in turns per second by wire id. Motion that the wheels can't
        follow is ignored, for example sideways motion with fixed wheels."""
        # Adding zero turns -0.0 into +0.0.
        return tuple([x * vx_mps + y * vy_mps + z * wz_radps + 0.0 for x, y, z in self._rows])

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The highest speed that any wheel can reach within these limits of the body's velocity, in turns per second.
        No limit may be negative."""
        return max(abs(x) * vx_mps + abs(y) * vy_mps + abs(z) * wz_radps for x, y, z in self._rows)


class Steered(Chassis):
    """A base with one or two driven wheels at the rear and a steered axle in front (Ackermann). It can turn only while
    it drives. A rear axle with a differential gear and one motor counts as one wheel."""

    __slots__ = ("_most_rad", "_rear", "_turns_most", "_wheelbase_m")
    steers = True

    def __init__(self, rear: Chassis, wheelbase_m: float, most_rad: float) -> None:
        """`rear`: the driven wheels; `wheelbase_m`: the distance between the axles; `most_rad`: the largest steering
        angle."""
        self._rear, self._wheelbase_m, self._most_rad = rear, wheelbase_m, most_rad
        self._turns_most = tan(most_rad) / wheelbase_m
        self.axes, self.rest = AXES[ACKERMANN], (*rear.rest, 0.0)

    def reach(self, velocity: Velocity) -> Velocity:
        """Limit a velocity to what the base can do. The forward speed stays the same, the sideways speed becomes 0, and
        the largest steering angle limits the turn."""
        vx, _, wz = velocity
        most = abs(vx) * self._turns_most
        return vx, 0.0, max(-most, min(most, wz))

    def wheels_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> WheelSpeeds:
        """The speed of each wheel in turns per second, by wire id, and then the angle of the steered wheels in rad. The
        angle is 0 if the base does not drive or does not turn."""
        vx, vy, wz = self.reach((vx_mps, vy_mps, wz_radps))
        angle = atan2(self._wheelbase_m * abs(wz), abs(vx)) if vx and wz else 0.0
        # With very small numbers, rounding would give a larger angle than that of the curve.
        return *self._rear.wheels_rps(vx, vy, wz), copysign(min(angle, self._most_rad), vx * wz) if angle else 0.0

    @property
    def turns_unseen(self) -> bool:
        """True if the base has only one driven wheel. Then only the commanded steering angle shows how the base
        turns."""
        return len(self._rear.rest) == 1

    def rolled(self) -> tuple[tuple[float, ...], ...]:
        """The factors of Chassis.rolled() for the driven rear wheels. With one rear wheel, the factors for wz are 0,
        because one wheel does not show how the base turns."""
        return self._rear.rolled()

    def turn_radps(self, vx_mps: float, steering_rad: float) -> float:
        """How fast the base turns at this steering angle (positive to the left), rad/s."""
        return vx_mps * tan(max(-self._most_rad, min(steering_rad, self._most_rad))) / self._wheelbase_m

    def worst_rps(self, vx_mps: float, vy_mps: float, wz_radps: float) -> float:
        """The highest speed of any wheel, turns per second. The outer wheel in the tightest curve is the fastest."""
        return self._rear.worst_rps(*self.reach((vx_mps, vy_mps, wz_radps)))


def _least_squares(rows: Sequence[Sequence[float]], axes: Velocity) -> tuple[tuple[float, ...], ...]:
    """The pseudo-inverse of the matrix `rows`, which has a row of three numbers for each wheel. For a direction with a
    0 in `axes`, the result is 0."""
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
    """The rim speeds of two or four wheels on a left and a right side. `lever_m`: the lever arm of each wheel about the
    middle of the base; `sideways`: FIXED or MECANUM. The signs are for mecanum wheels in the usual mounting: to move
    left, the front left wheel and the rear right wheel turn backward."""
    sides = (-1.0, 1.0) if wheels == 2 else (-1.0, -1.0, 1.0, 1.0)
    return [(1.0, (side if number % 2 == 0 else -side) * sideways, side * lever_m) for number, side in enumerate(sides)]


def omni(lever_m: float, ways_deg: Sequence[float]) -> list[RimSpeeds]:
    """The rim speeds of omni wheels around the middle of the base. Each wheel rolls in one direction, and its rollers
    let it slide at a right angle to that direction. `ways_deg`: the rolling direction of each wheel, in degrees
    counter-clockwise from forward. If every wheel rolls forward in its direction, the robot turns counter-clockwise."""
    # Rounded, so that a wheel that rolls at a right angle to the motion does not turn at all.
    return [(round(cos(radians(way)), 15), round(sin(radians(way)), 15), lever_m) for way in ways_deg]


def from_settings(settings: Settings) -> Chassis:
    """The kinematics of the robot, from the settings wheels.layout and [wheels]."""
    layout, mounted = settings.text("wheels.layout"), mounted_wheels(settings.values)
    if layout == "omni3":
        rows = omni(settings["wheels.lever_m"], [settings[f"wheels.angle_{number}_deg"] for number in (1, 2, 3)])
    elif layout == "mecanum":
        rows = two_sides(len(mounted), (settings["wheels.wheelbase_m"] + settings["wheels.track_m"]) / 2, MECANUM)
    elif layout == "differential":
        # A base that skids turns less than one whose wheels roll cleanly, so the setting makes its track wider.
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
    `mounted`: the result of settings.mounted_wheels(). `steering_rad`: the steering angle, positive to the left. If it
    is given, it determines the turn, and the wheel speeds determine only the forward speed. Raises ValueError, for
    example if it is given for a base without steered wheels."""
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
    """The highest speed that any wheel can reach within the limits in the settings, turns per second."""
    return from_settings(settings).worst_rps(*(settings[f"limits.{axis}"] for axis in ("vx_mps", "vy_mps", "wz_radps")))
