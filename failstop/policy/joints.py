"""Joints: the settings of each joint of the arm, and where the joint is. Pure.

Positions are in pulses of the servo. A commanded position keeps its fraction, and is rounded only when a frame for the
servo is made. Rounding in every step would spoil slow moves: at 0.3 rad/s, a joint moves only 2.9 pulses in a step.
"""

from __future__ import annotations

from math import copysign, isfinite, pi, sqrt

from failstop.board.kinds import facts_of
from failstop.policy.settings import Settings

MOST_MISSES = 4
"""A servo counts as silent if it has not answered this many questions in a row."""


class Joint:
    """One joint of the arm: its settings, and what is known about it."""

    def __init__(
        self,
        name: str,
        table: dict[str, float | str],
        highest: int,
        turn: int,
    ) -> None:
        """`table`: the joint's settings; `highest`: the servo's highest position in pulses; `turn`: how many pulses
        make a whole turn."""
        number = {key: float(value) for key, value in table.items() if not isinstance(value, str)}
        self.name = name
        self.servo = int(number["servo"])
        self.zero = number["zero"]
        self.sign = number["sign"]
        self.low, self.high = number["low"], number["high"]
        self.highest, self.per_rad = highest, turn / (2 * pi)
        self.speed_radps = number["speed_radps"]
        self.speed = self.speed_radps * self.per_rad
        self.acceleration = number["acceleration_radps2"] * self.per_rad
        self.tuck, self.drive = int(number["tuck"]), int(number["drive"])
        self.judged = table["judged"] == "on"
        self.position = 0.0
        """The commanded position in pulses, with a fraction. It is valid only while `known` is True."""
        self.velocity = 0.0
        self.known = False
        """True if the joint is at `position`: the servo's position was read, and the joint has since moved only as
        commanded. A joint without torque may have been moved by hand since, so it is read again before it moves."""
        self.loaded: bool | None = None
        """True if the torque is on, False if it is off, as the servo last reported or as the arm last switched it. None
        if neither has happened yet, or not since the servo was silent."""
        self.measured: int | None = None
        self.measured_ns = 0
        self.unpaired: int | None = None
        """The newest reading of the position, in pulses. It is compared with the next reading, because a position
        counts as measured only if two readings in a row are almost equal."""
        self.misses = 0
        """How many questions in a row the servo has not answered."""
        self.temperature_c = self.supply_mv = 0
        self.stepped_ns = 0

    @property
    def silent(self) -> bool:
        """True if the joint's servo does not answer."""
        return self.misses >= MOST_MISSES

    def pulses(self, angle_rad: float) -> float:
        """Convert an angle in rad to a position in pulses."""
        return self.zero + self.turned(angle_rad)

    def turned(self, angle_rad: float) -> float:
        """Convert a change of the angle (rad) to pulses, or a rate (rad/s) to pulses/s."""
        return self.sign * angle_rad * self.per_rad

    def rad(self, pulses: float) -> float:
        """Convert a position in pulses to an angle in rad."""
        return (pulses - self.zero) * self.sign / self.per_rad

    def range_rad(self) -> tuple[float, float]:
        """The lowest and the highest angle that the joint may be moved to, rad."""
        low, high = sorted((self.rad(self.low), self.rad(self.high)))
        return low, high

    def state(self) -> tuple[str, int, float | None, int | None, int, bool | None, int, int]:
        """The joint's values in the gate's state: name, servo id, commanded position (None if it is not known),
        measured position and its time, torque, temperature and supply voltage."""
        position = round(self.position, 2) if self.known else None
        read = (self.measured, self.measured_ns, self.loaded, self.temperature_c, self.supply_mv)
        return (self.name, self.servo, position, *read)

    def forget(self) -> None:
        """Mark the position as unknown, so that it is read again. Call this after the joint was stopped or released
        during a move, and when its servo has fallen silent."""
        self.known = False
        self.velocity = 0.0
        self.unpaired = None

    def step_towards(self, target: float, share: float, elapsed_s: float) -> None:
        """Take one step toward the position `target`, and slow down in time to stop there. `share`: the share of the
        joint's highest speed that the step may use."""
        gap = target - self.position
        wanted = min(self.speed * share, abs(gap) / elapsed_s, self._stops_within(abs(gap), elapsed_s))
        self._step(copysign(wanted, gap), elapsed_s)

    def jog(self, rate: float, elapsed_s: float) -> None:
        """Take one step at the rate `rate` (pulses/s). The joint slows down in time to stop at the end of its range."""
        room = (self.high - self.position) if rate > 0 else (self.position - self.low)
        wanted = min(abs(rate), self.speed, self._stops_within(max(0.0, room), elapsed_s))
        self._step(copysign(wanted, rate), elapsed_s)

    def _stops_within(self, way: float, elapsed_s: float) -> float:
        """The highest speed, in pulses/s, from which the joint can stop within the distance `way` (pulses).
        `elapsed_s`: how long a step takes."""
        ramp = self.acceleration * elapsed_s
        return ramp * (sqrt(0.25 + 2 * way / (ramp * elapsed_s)) - 0.5)

    def _step(self, wanted: float, elapsed_s: float) -> None:
        most = self.acceleration * elapsed_s
        self.velocity += max(-most, min(most, wanted - self.velocity))
        # If someone has turned the joint out of its range by hand, it returns at its normal speed, not in one jump.
        low, high = min(self.low, self.position), max(self.high, self.position)
        self.position = max(low, min(high, self.position + self.velocity * elapsed_s))


def from_settings(settings: Settings) -> list[Joint]:
    """The arm's joints in the order of the settings. Empty if the robot has no arm."""
    facts = facts_of(settings.text("board.kind"))
    if not (facts and facts.arm):
        return []
    tables = settings.named["joints"].items()
    joints = [Joint(name, table, facts.arm.highest, facts.arm.turn) for name, table in tables]
    for joint in joints:
        if joint.servo == int(settings["arm.base_servo"]):
            pan = int(settings["arm.drive_pan"])
            joint.drive, joint.judged = pan, pan >= 0
    return joints


def too_far(angles: dict[Joint, float]) -> str:
    """Why joints may not move to these angles: a text about the first angle that is not allowed, with the joint's
    range. Empty if all angles are allowed."""
    for joint, angle in angles.items():
        low, high = joint.range_rad()
        if not isfinite(angle) or not low - 1e-6 <= angle <= high + 1e-6:
            return f"joint {joint.name} to {angle:g} rad: allowed is {low:.3f} to {high:.3f}"
    return ""
