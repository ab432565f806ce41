"""Facts: what the settings must know about a kind of board before a Board is made. Each board's folder has a
facts.py."""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping


USUAL_CAN_ID = 1
"""The default of the setting board.can_id."""


class ArmFacts(Data):
    """What the settings must know about the servos of an arm on this board."""

    highest: int
    """The highest position of a servo, in pulses. The lowest is 0."""
    turn: int
    """How many pulses make a whole turn."""
    wheels: tuple[int, ...] = ()
    """The ids of servos on the same bus that turn the wheels. No joint may use these ids."""
    joint: Mapping[str, float] = {}
    """Defaults of a joint's settings, by key, where they differ from the usual ones."""


class SteeringServo(Data):
    """The servo of a steered base, as the settings describe it."""

    kind: str
    """How the servo is connected: "pwm" or "bus". The names are those of the setting."""
    id: int
    centre: int
    """The pulses at which the wheels point straight ahead."""
    per_rad: float
    """How many pulses are added for one radian to the left. If it is negative, pulses are subtracted."""
    most_rad: float
    """The largest steering angle to each side, in radians."""


class Facts(Data):
    """What the settings must know about one kind of board."""

    speeds: int
    """How many speeds a frame sets. For a base whose layout is in `layouts`, the number there counts instead."""
    imu: bool
    """True if the board has an IMU."""
    arm: ArmFacts | None = None
    """The arm's servos. None if the board has no servos for an arm."""
    steers: Mapping[str, tuple[int, int, int]] = {}
    """The kinds of servos that can steer a base on this board: for each kind its fewest and most pulses, and its
    highest id. Empty if the board can't steer."""
    layouts: Mapping[str, int] = {}
    """How many speeds a frame sets on a base with one of these layouts (the setting wheels.layout), where this differs
    from `speeds`."""
    most: int = 0
    """The most speeds that a frame can set. If a wheel's id is higher than the layout needs, frames get longer, up to
    this number. 0 means that frames are always as long as the layout needs."""
    steered_defaults: Mapping[str, float] = {}
    """Defaults of settings for a steered base, by key, where they differ from the usual ones."""
    can: bool = False
    """True if the board's second motor is connected by CAN. The setting board.can_id then has the id of that motor."""
    motors: Mapping[int, str] = {}
    """Names of the motors that have controllers of their own, by the ids in their reports (wire.Health)."""
    defaults: Mapping[str, float] = {}
    """Defaults of settings, by key, where they differ from the usual ones."""
