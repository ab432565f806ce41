"""Facts: what the settings need to know of a kind of board before a Board is made; facts.py of each folder has them."""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping


class ArmFacts(Data):
    """An arm's servos on that board."""

    highest: int
    """The last of a servo's pulses, which are counted from 0."""
    turn: int
    """Pulses of a whole turn."""
    wheels: tuple[int, ...] = ()
    """Ids of servos on the same bus that turn the wheels, so no joint may have them."""
    joint: Mapping[str, float] = {}
    """Defaults of a joint's settings, where the board has other ones than most."""


class SteeringServo(Data):
    """The servo of a steered base, as the settings have it."""

    kind: str
    """"pwm" or "bus"."""
    id: int
    centre: int
    """Its pulses for straight ahead."""
    per_rad: float
    """Pulses more for a radian to the left; negative: fewer."""
    most_rad: float
    """The largest angle to each side."""


class Facts(Data):
    """One kind of board."""

    speeds: int
    """How many speeds a frame sets."""
    imu: bool
    """The board has an IMU."""
    arm: ArmFacts | None = None
    """None: the board has no servos for an arm."""
    steers: bool = False
    """The board can turn the servo of a steered base."""
    defaults: Mapping[str, float] = {}
    """Defaults of settings by their keys, where the board has other ones than most."""
