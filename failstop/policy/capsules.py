"""Capsules: finds out if the arm would hit itself, the chassis or the floor during a move. Pure. A stop never waits for
this computation.

A capsule is a cylinder with round ends. The arm is modelled as a chain of capsules, one after each joint. If all angles
are zero, the chain points straight up from its mount. A joint turns the rest of the arm about the vertical (yaw), about
a sideways axis (pitch), or about its own axis (roll). A gripper's joint turns nothing (none). The chassis is one
capsule along the robot. Lengths, radii and the mount come from the settings.
"""

from __future__ import annotations

from math import ceil, cos, dist, inf, sin

from failstop.policy.settings import Settings

Point = tuple[float, float, float]
Capsule = tuple[str, Point, Point, float]

FLOOR = "the floor"
CHASSIS = "the chassis"
STEP_RAD = 0.05
"""A move is checked at points of its path. From one point to the next, no joint turns further than this, in rad. Such a
turn moves the tip of an arm with a reach of 0.1 m by 5 mm, and with a reach of 0.3 m by 15 mm."""


class Model:
    def __init__(self, settings: Settings) -> None:
        self._links = [
            (name, str(table["turns"]), float(table["length_m"]), float(table["radius_m"]))
            for name, table in settings.named["joints"].items()
        ]
        self._mount = (settings["arm.mount_x_m"], 0.0, settings["arm.mount_z_m"])
        half_m, height_m = settings["arm.chassis_length_m"] / 2, settings["arm.chassis_z_m"]
        radius_m = settings["arm.chassis_radius_m"]
        reach_m = max(0.0, half_m - radius_m)
        self._chassis: Capsule = (CHASSIS, (-reach_m, 0.0, height_m), (reach_m, 0.0, height_m), radius_m)

    def capsules(self, angles: dict[str, float]) -> list[Capsule]:
        """The capsules of the arm's links at these angles (rad, by joint name), starting at the mount."""
        found: list[Capsule] = []
        at, yaw, pitch = self._mount, 0.0, 0.0
        for name, turns, length_m, radius_m in self._links:
            yaw += angles.get(name, 0.0) if turns == "yaw" else 0.0
            pitch += angles.get(name, 0.0) if turns == "pitch" else 0.0
            across = length_m * sin(pitch)
            end = (at[0] + across * cos(yaw), at[1] + across * sin(yaw), at[2] + length_m * cos(pitch))
            if length_m > 0.0:
                found.append((name, at, end, radius_m))
            at = end
        return found

    def nearest(self, angles: dict[str, float]) -> tuple[float, str, str]:
        """The smallest gap between two parts at these angles, in m, with the names of the two parts. A gap below 0
        means that the two parts touch. A link is not compared with the next link, because the two are joined. The first
        link is not compared with the chassis and the floor either."""
        links = self.capsules(angles)
        found = (inf, "", "")
        for index, link in enumerate(links):
            name, begin, end, radius_m = link
            if index:
                found = min(
                    found, (min(begin[2], end[2]) - radius_m, name, FLOOR), (_gap_m(link, self._chassis), name, CHASSIS)
                )
            for other in links[index + 2 :]:
                found = min(found, (_gap_m(link, other), name, other[0]))
        return found


def would_hit(name: str, other: str, when: str = "") -> str:
    return f"the arm would hit something {when}on its way: {name} and {other}"


def _gap_m(one: Capsule, other: Capsule) -> float:
    return apart_m(one[1], one[2], other[1], other[2]) - one[3] - other[3]


def apart_m(p1: Point, q1: Point, p2: Point, q2: Point) -> float:
    """The distance in m between two line segments, from `p1` to `q1` and from `p2` to `q2`."""
    d1, d2, r = _minus(q1, p1), _minus(q2, p2), _minus(p1, p2)
    a, e, b, c, f = _dot(d1, d1), _dot(d2, d2), _dot(d1, d2), _dot(d1, r), _dot(d2, r)
    s = _held(b * f - c * e, a * e - b * b)
    t = _held(b * s + f, e)
    s = _held(b * t - c, a)
    return dist(_on(p1, d1, s), _on(p2, d2, t))


def _held(part: float, whole: float) -> float:
    """Divide `part` by `whole`, and limit the result to 0..1. Returns 0 if `whole` is 0. `whole` is 0 if the line
    segments are parallel, or if one of them is a single point. Any value from 0 to 1 is right in these cases."""
    return max(0.0, min(1.0, part / whole)) if whole > 0.0 else 0.0


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _minus(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _on(begin: Point, way: Point, share: float) -> Point:
    return begin[0] + share * way[0], begin[1] + share * way[1], begin[2] + share * way[2]


def on_the_way(
    model: Model, start: dict[str, float], rows: list[tuple[float, dict[str, float]]]
) -> tuple[float, str, str] | None:
    """Find the first collision of an arm that moves from `start` through the angles of all rows. From row to row, every
    joint turns evenly. Returns the time until the collision in seconds (0 if the rows have no times) and the names of
    the two parts, or None. Parts that touch at the start and move apart are no collision."""
    at_s, at, gap_m = 0.0, start, model.nearest(start)[0]
    for t_s, to in rows:
        end = {**at, **to}
        turns = {name: angle - at.get(name, 0.0) for name, angle in end.items()}
        steps = max(1, ceil(max(map(abs, turns.values())) / STEP_RAD))
        for step in range(1, steps + 1):
            share = step / steps
            was_m = gap_m
            gap_m, name, other = model.nearest({name: at.get(name, 0.0) + share * turn for name, turn in turns.items()})
            if gap_m < min(0.0, was_m):
                return at_s + share * (t_s - at_s), name, other
        at_s, at = t_s, end
    return None
