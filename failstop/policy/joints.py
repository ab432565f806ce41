"""Joints: each joint's settings, and where the joint is. Pure. Positions are in pulses, fractional where they are
commanded. Rounding is left to the frame, because 0.3 rad/s are 2.9 pulses per move, and slower moves are fractions of
one."""

from __future__ import annotations

from math import copysign, isfinite, pi, sqrt

from failstop.board.kinds import facts_of
from failstop.policy.settings import Settings

MOST_MISSES = 4
"""A servo that leaves this many questions in a row unanswered counts as silent."""


class Joint:
    """One joint of the arm: its settings, and what is known about it."""

    def __init__(
        self,
        name: str,
        table: dict[str, float | str],
        highest: int,
        turn: int,
    ) -> None:
        """`highest`: the last of its pulses; `turn`: pulses in a whole turn."""
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
        """The commanded position, fractional. It means something only while `known`."""
        self.velocity = 0.0
        self.known = False
        """True if its position has been read, and since then only its own stream of moves has moved it."""
        self.loaded: bool | None = None
        """True if its torque was switched on, and nothing says that it is off since then; None if it was neither
        switched nor read yet."""
        self.measured: int | None = None
        self.measured_ns = 0
        self.unpaired: int | None = None
        """A reading that counts only once a second one equals it."""
        self.misses = 0
        """How many questions in a row have had no answer."""
        self.temperature_c = self.supply_mv = 0
        self.stepped_ns = 0

    @property
    def silent(self) -> bool:
        """True if the joint's servo does not answer."""
        return self.misses >= MOST_MISSES

    def pulses(self, angle_rad: float) -> float:
        """The position in pulses that an angle in rad stands for."""
        return self.zero + self.turned(angle_rad)

    def turned(self, angle_rad: float) -> float:
        """A change, or a rate, of the angle as pulses."""
        return self.sign * angle_rad * self.per_rad

    def rad(self, pulses: float) -> float:
        """The angle in rad that a position in pulses stands for."""
        return (pulses - self.zero) * self.sign / self.per_rad

    def range_rad(self) -> tuple[float, float]:
        """The lowest and the highest angle to which the joint may be sent, rad."""
        low, high = sorted((self.rad(self.low), self.rad(self.high)))
        return low, high

    def state(self) -> tuple[str, int, float | None, int | None, int, bool | None, int, int]:
        """The joint's state, for people and programs."""
        position = round(self.position, 2) if self.known else None
        read = (self.measured, self.measured_ns, self.loaded, self.temperature_c, self.supply_mv)
        return (self.name, self.servo, position, *read)

    def forget(self) -> None:
        """Forget its position, because it was stopped or released on its way, so it must be read again."""
        self.known = False
        self.velocity = 0.0
        self.unpaired = None

    def step_towards(self, target: float, share: float, elapsed_s: float) -> None:
        """Move toward a position, with at most `share` of its speed, slowly enough that it can still stop there."""
        gap = target - self.position
        wanted = min(self.speed * share, abs(gap) / elapsed_s, self._stops_within(abs(gap), elapsed_s))
        self._step(copysign(wanted, gap), elapsed_s)

    def jog(self, rate: float, elapsed_s: float) -> None:
        """Move at a rate (pulses/s) until a bound is reached."""
        room = (self.high - self.position) if rate > 0 else (self.position - self.low)
        wanted = min(abs(rate), self.speed, self._stops_within(max(0.0, room), elapsed_s))
        self._step(copysign(wanted, rate), elapsed_s)

    def _stops_within(self, way: float, elapsed_s: float) -> float:
        """The highest speed from which the joint can still stop within this distance, in steps of this length."""
        ramp = self.acceleration * elapsed_s
        return ramp * (sqrt(0.25 + 2 * way / (ramp * elapsed_s)) - 0.5)

    def _step(self, wanted: float, elapsed_s: float) -> None:
        most = self.acceleration * elapsed_s
        self.velocity += max(-most, min(most, wanted - self.velocity))
        # A joint that was turned by hand beyond its bounds comes back at its speed, not in one leap.
        low, high = min(self.low, self.position), max(self.high, self.position)
        self.position = max(low, min(high, self.position + self.velocity * elapsed_s))


def from_settings(settings: Settings) -> list[Joint]:
    """The arm's joints in the order of the settings; none on a robot without an arm."""
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
    """The text about a joint that may not be sent there, with its range; empty if all may."""
    for joint, angle in angles.items():
        low, high = joint.range_rad()
        if not isfinite(angle) or not low - 1e-6 <= angle <= high + 1e-6:
            return f"joint {joint.name} to {angle:g} rad: allowed is {low:.3f} to {high:.3f}"
    return ""
