"""Facts: what the settings need to know about a kind of board before a Board is made. Each folder has a facts.py."""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping


class ArmFacts(Data):
    """The servos of an arm on that board."""

    highest: int
    """The highest of a servo's pulses, which are counted from 0."""
    turn: int
    """Pulses in a whole turn."""
    wheels: tuple[int, ...] = ()
    """Ids of servos on the same bus that turn the wheels, so that no joint may use them."""
    joint: Mapping[str, float] = {}
    """Defaults of a joint's settings that differ from the usual ones."""


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
    """One kind of board."""

    speeds: int
    """How many speeds a frame sets."""
    imu: bool
    """The board has an IMU."""
    arm: ArmFacts | None = None
    """None if the board has no servos for an arm."""
    steers: bool = False
    """The board can turn the servo of a steered base."""
    defaults: Mapping[str, float] = {}
    """Defaults of settings, by key, that differ from the usual ones."""
