"""Units: LeRobot's numbers for a joint from failstop's angles, and back. Pure.

A calibration file of LeRobot has the ends of each joint's range in positions of its servo. A settings file of failstop
has low and high in the same positions, so a position is what both sides know: angles go through Joint.pulses and
Joint.rad, and numbers by the rule that LeRobot's own motor bus has for the calibration. Another soft limit in the
settings therefore leaves the numbers, and a policy that was trained on them, as they are.
"""

from __future__ import annotations

from enum import Enum
from math import degrees, isfinite, radians, tau
from typing import NamedTuple, Protocol


class Joint(Protocol):
    """A joint as `failstop.Robot.arm.joints` has it."""

    servo: int
    low: float
    high: float

    def pulses(self, angle_rad: float) -> float:
        """The position of the servo at an angle."""

    def rad(self, pulses: float) -> float:
        """The angle at a position of the servo."""

    def turned(self, angle_rad: float) -> float:
        """The change of the position by a change of the angle."""

    def range_rad(self) -> tuple[float, float]:
        """The angles that it may be sent to, the smaller first."""


class Unit(Enum):
    """Unit of a joint's number."""

    SHARE = "-100 to 100 over the calibrated range"
    GRIP = "0 to 100 over the calibrated range"
    DEGREES = "degrees from the middle of the calibrated range"


class Reach(NamedTuple):
    """The calibrated range of a joint, in positions of its servo."""

    low: float
    high: float
    inverted: bool = False
    """LeRobot's drive_mode: a higher position is a smaller number; degrees do not know it."""


def number(position: float, reach: Reach, unit: Unit, turn: float) -> float:
    """The number of a position. `turn`: positions of a whole turn."""
    low, high, inverted = reach
    if unit is Unit.DEGREES:
        return (position - (low + high) / 2) * 360 / (turn - 1)
    share = (min(high, max(low, position)) - low) / (high - low)
    share = 1 - share if inverted else share
    return 100 * share if unit is Unit.GRIP else 200 * share - 100


def position(value: float, reach: Reach, unit: Unit, turn: float) -> float:
    """The position of a number, within the calibrated range but for degrees. `turn`: as for number()."""
    low, high, inverted = reach
    if unit is Unit.DEGREES:
        return value * (turn - 1) / 360 + (low + high) / 2
    share = value / 100 if unit is Unit.GRIP else (value + 100) / 200
    share = min(1.0, max(0.0, 1 - share if inverted else share))
    return low + share * (high - low)


class Scale:
    """LeRobot's numbers of one joint of a service."""

    def __init__(self, name: str, joint: Joint, reach: Reach | None, unit: Unit) -> None:
        """`reach`: by a calibration; None: what the settings allow. Raises ValueError for an empty one."""
        self.name = name
        self._joint, self._unit = joint, unit
        self._reach = reach or Reach(joint.low, joint.high)
        self._turn = abs(joint.turned(tau))
        if self._reach.low >= self._reach.high:
            raise ValueError(f"joint {name}: a range from {self._reach.low:g} to {self._reach.high:g} is none")

    def number(self, angle_rad: float) -> float:
        """LeRobot's number of an angle."""
        return number(self._joint.pulses(angle_rad), self._reach, self._unit, self._turn)

    def angle_rad(self, value: float) -> float:
        """The angle of LeRobot's number, within what the settings allow. Raises ValueError for one not finite."""
        if not isfinite(value):
            raise ValueError(f"arm_{self.name}.pos is {value}: every value must be finite")
        low, high = self._joint.range_rad()
        return min(high, max(low, self._joint.rad(position(value, self._reach, self._unit, self._turn))))


def base_numbers(vx_mps: float, vy_mps: float, wz_radps: float) -> dict[str, float]:
    """LeKiwi's numbers of a velocity: m/s, m/s, deg/s."""
    return {"x.vel": vx_mps, "y.vel": vy_mps, "theta.vel": degrees(wz_radps)}


def base_velocity(x: float, y: float, theta: float) -> tuple[float, float, float]:
    """Velocity in m/s, m/s, rad/s of LeKiwi's numbers. Raises ValueError for one that is not finite."""
    for name, value in zip(("x.vel", "y.vel", "theta.vel"), (x, y, theta), strict=True):
        if not isfinite(value):
            raise ValueError(f"{name} is {value}: every value must be finite")
    return x, y, radians(theta)
