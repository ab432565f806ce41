"""A base on a floor, with wheels that a board counts or measures: what odometry is judged by.

It shares nothing with failstop's kinematics. Each wheel has a place and a way to roll, and what it rolls is the speed
of the floor under it along that way.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence

Way = tuple[float, float, float]
"""m/s ahead, m/s to the left, rad/s."""
Wheel = tuple[float, float, float, float]
"""Where it is, m ahead and m to the left of the middle; the way that it rolls, rad to the left; and for a mecanum wheel
the angle of its rollers against its axle, rad; 0: it has none, or omni wheels' along its way."""


def two(track_m: float) -> tuple[Wheel, ...]:
    return (0.0, track_m / 2, 0.0, 0.0), (0.0, -track_m / 2, 0.0, 0.0)


def omni(lever_m: float, ways_deg: Sequence[float] = (150.0, 270.0, 30.0)) -> tuple[Wheel, ...]:
    """Each rolls across the line to the middle, so it is a quarter turn behind its way."""
    ways = [math.radians(way) for way in ways_deg]
    return tuple((lever_m * math.sin(way), -lever_m * math.cos(way), way, 0.0) for way in ways)


def mecanum(wheelbase_m: float, track_m: float) -> tuple[Wheel, ...]:
    """Front left, rear left, front right, rear right; rollers that touch the floor point to the middle."""
    a, b = wheelbase_m / 2, track_m / 2
    quarter = math.pi / 4
    return (a, b, 0.0, quarter), (-a, b, 0.0, -quarter), (a, -b, 0.0, -quarter), (-a, -b, 0.0, quarter)


def rolls(wheel: Wheel, way: Way) -> float:
    """Speed at the rim, m/s."""
    x, y, heading, rollers = wheel
    vx, vy = way[0] - way[2] * y, way[1] + way[2] * x
    ahead = vx * math.cos(heading) + vy * math.sin(heading)
    aside = -vx * math.sin(heading) + vy * math.cos(heading)
    return ahead - aside * math.tan(rollers)


class Base:
    """Where it is, and how far each wheel has turned (forward positive), with an error of each of its own."""

    def __init__(self, wheels: Sequence[Wheel], diameter_m: float, noise: float = 0.0, seed: int = 1) -> None:
        self._wheels, self._rim_m, self._noise = wheels, math.pi * diameter_m, noise
        self._random = random.Random(seed)
        self.x_m = self.y_m = self.th_rad = 0.0
        self.turns = [0.0] * len(wheels)
        self.rps = [0.0] * len(wheels)

    def go(self, way: Way, dt_s: float) -> None:
        """`noise`: the standard deviation of what a wheel turns, as a share of it."""
        middle = self.th_rad + way[2] * dt_s / 2
        self.x_m += (way[0] * math.cos(middle) - way[1] * math.sin(middle)) * dt_s
        self.y_m += (way[0] * math.sin(middle) + way[1] * math.cos(middle)) * dt_s
        self.th_rad += way[2] * dt_s
        for at, wheel in enumerate(self._wheels):
            self.rps[at] = rolls(wheel, way) / self._rim_m * (1 + self._random.gauss(0.0, self._noise))
            self.turns[at] += self.rps[at] * dt_s


def square(side_m: float, speed_mps: float, turn_radps: float, dt_s: float, radius_m: float = 0.0) -> Iterator[Way]:
    """Four sides and four turns to the left, with ramps of 0.5 m/s2 and 2 rad/s2, and a rest between them."""
    ahead = (speed_mps, 0.0, 0.0)
    turn = (radius_m * turn_radps, 0.0, turn_radps)
    for _ in range(4):
        yield from _ramped(ahead, side_m / speed_mps, speed_mps / 0.5, dt_s)
        yield from _ramped(turn, math.pi / 2 / turn_radps, turn_radps / 2.0, dt_s)


def _ramped(way: Way, seconds: float, ramp_s: float, dt_s: float) -> Iterator[Way]:
    """As far as `seconds` of it would go, and then a rest of 0.5 s."""
    steps, ramp, rest = round(seconds / dt_s), max(1, round(ramp_s / dt_s)), round(0.5 / dt_s)
    shares = [(at + 0.5) / ramp for at in range(ramp)]
    share_of = [*shares, *[1.0] * (steps - ramp), *reversed(shares), *[0.0] * rest]
    for share in share_of:
        yield way[0] * share, way[1] * share, way[2] * share


def hoverboard_word(rpm: float) -> int:
    """As that firmware makes it: sixteenths of an rpm, of which it keeps the whole ones, rounded down. It waits 0.125 s
    for the next of 90 steps of a turn, so nothing slower than 5.3 rpm is a speed."""
    if abs(rpm) < 60 / 90 / 0.125:
        return 0
    return math.floor(math.copysign(math.floor(abs(rpm) * 16), rpm) / 16)


Report = Callable[[Base], tuple[tuple[float, ...], tuple[float, ...]]]
"""Of a base: speeds and positions in the board's unit."""
