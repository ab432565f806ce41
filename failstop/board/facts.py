"""Facts: what the settings must know about a kind of board before a Board is made. The folder of each board has a
facts.py."""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping


USUAL_CAN_ID = 1
"""The default of the setting board.can_id."""


class ArmFacts(Data):
    """The servos of an arm on that board."""

    highest: int
    """The highest position of a servo, in pulses; the lowest is 0."""
    turn: int
    """How many pulses make a whole turn."""
    wheels: tuple[int, ...] = ()
    """Ids of servos on the same bus that turn the wheels. No joint may use them."""
    joint: Mapping[str, float] = {}
    """Defaults of a joint's settings that are not the usual ones."""


class SteeringServo(Data):
    """The servo of a steered base, from the settings."""

    kind: str
    """"pwm" or "bus"."""
    id: int
    centre: int
    """Its pulses for straight ahead."""
    per_rad: float
    """Pulses added for one radian to the left; negative: subtracted."""
    most_rad: float
    """The largest angle to each side."""


class Facts(Data):
    """The facts about one kind of board."""

    speeds: int
    """How many speeds a frame sets, unless `layouts` has another number."""
    imu: bool
    """True if the board has an IMU."""
    arm: ArmFacts | None = None
    """None if the board has no servos for an arm."""
    steers: Mapping[str, tuple[int, int, int]] = {}
    """The kinds of servos that can steer a base on it, each with its least and most pulses and its highest id; empty if
    none can."""
    layouts: Mapping[str, int] = {}
    """How many speeds a frame sets on a base with one of these layouts (wheels.layout), where that differs."""
    most: int = 0
    """How many speeds a frame can set. If a wheel's id is higher than the layout needs, the frames become longer, up to
    this. 0: frames are as long as the layout needs."""
    steered_defaults: Mapping[str, float] = {}
    """Like `defaults`, for a steered base."""
    can: bool = False
    """True if its second motor is connected by CAN; the setting board.can_id then has that motor's id."""
    motors: Mapping[int, str] = {}
    """Names of the motors whose controllers answer for themselves, by the ids in reports about them (wire.Health)."""
    defaults: Mapping[str, float] = {}
    """Defaults of settings, by key, that are not the usual ones."""
