"""Units: converts between failstop's angles and LeRobot's numbers for a joint. Pure.

The servo's position connects the two. Joint.pulses and Joint.rad convert angles. The rule of LeRobot's own motor bus
converts numbers over the calibrated range. With a calibration, the numbers don't depend on the soft limits in
failstop's settings (low and high), so a trained policy still works after these limits change.
"""

from __future__ import annotations

from enum import Enum
from math import degrees, isfinite, radians, tau
from typing import NamedTuple, Protocol


class Joint(Protocol):
    """A joint as in `failstop.Robot.arm.joints`."""

    servo: int
    low: float
    high: float

    def pulses(self, angle_rad: float) -> float:
        """The servo's position at this angle."""

    def rad(self, pulses: float) -> float:
        """The angle at this position of the servo."""

    def turned(self, angle_rad: float) -> float:
        """The change of the servo's position if the angle changes by `angle_rad`."""

    def range_rad(self) -> tuple[float, float]:
        """The angles to which the joint may be sent: (smallest, largest)."""


class Unit(Enum):
    """The unit of a joint's numbers in LeRobot."""

    SHARE = "-100 to 100 over the calibrated range"
    GRIP = "0 to 100 over the calibrated range"
    DEGREES = "degrees from the middle of the calibrated range"


class Reach(NamedTuple):
    """The calibrated range of a joint, in positions of its servo."""

    low: float
    high: float
    inverted: bool = False
    """LeRobot's drive_mode: True if a higher position is a smaller number. It does not affect degrees."""


def number(position: float, reach: Reach, unit: Unit, turn: float) -> float:
    """Convert a servo's position to LeRobot's number in this unit. `turn`: how many positions make a whole turn."""
    low, high, inverted = reach
    if unit is Unit.DEGREES:
        return (position - (low + high) / 2) * 360 / (turn - 1)
    share = (min(high, max(low, position)) - low) / (high - low)
    share = 1 - share if inverted else share
    return 100 * share if unit is Unit.GRIP else 200 * share - 100


def position(value: float, reach: Reach, unit: Unit, turn: float) -> float:
    """The position for a number. It is limited to the calibrated range, except in degrees. `turn`: how many positions
    make a whole turn."""
    low, high, inverted = reach
    if unit is Unit.DEGREES:
        return value * (turn - 1) / 360 + (low + high) / 2
    share = value / 100 if unit is Unit.GRIP else (value + 100) / 200
    share = min(1.0, max(0.0, 1 - share if inverted else share))
    return low + share * (high - low)


class Scale:
    """Converts between LeRobot's numbers and the angles of one joint."""

    def __init__(self, name: str, joint: Joint, reach: Reach | None, unit: Unit) -> None:
        """`reach`: the calibrated range, or None to use the range in the settings. Raises ValueError if the range is
        empty."""
        self.name = name
        self._joint, self._unit = joint, unit
        self._reach = reach or Reach(joint.low, joint.high)
        self._turn = abs(joint.turned(tau))
        if self._reach.low >= self._reach.high:
            raise ValueError(f"joint {name}: a range from {self._reach.low:g} to {self._reach.high:g} is none")

    def number(self, angle_rad: float) -> float:
        """LeRobot's number for this angle."""
        return number(self._joint.pulses(angle_rad), self._reach, self._unit, self._turn)

    def angle_rad(self, value: float) -> float:
        """The angle for LeRobot's number, limited to the range in the settings. Raises ValueError if the number is not
        finite."""
        if not isfinite(value):
            raise ValueError(f"arm_{self.name}.pos is {value}: every value must be finite")
        low, high = self._joint.range_rad()
        return min(high, max(low, self._joint.rad(position(value, self._reach, self._unit, self._turn))))


def base_numbers(vx_mps: float, vy_mps: float, wz_radps: float) -> dict[str, float]:
    """LeKiwi's numbers for a velocity: x.vel and y.vel in m/s, theta.vel in deg/s."""
    return {"x.vel": vx_mps, "y.vel": vy_mps, "theta.vel": degrees(wz_radps)}


def base_velocity(x: float, y: float, theta: float) -> tuple[float, float, float]:
    """The velocity (m/s, m/s, rad/s) for LeKiwi's numbers. Raises ValueError if one is not finite."""
    for name, value in zip(("x.vel", "y.vel", "theta.vel"), (x, y, theta), strict=True):
        if not isfinite(value):
            raise ValueError(f"{name} is {value}: every value must be finite")
    return x, y, radians(theta)
