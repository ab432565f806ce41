"""Facts: the facts about a kind of board that failstop needs to read the settings, before it makes a Board. They are in
facts.py in each board's folder."""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping


USUAL_CAN_ID = 1
"""The default of the setting board.can_id."""


class ArmFacts(Data):
    """Facts about the servos of an arm on this kind of board."""

    highest: int
    """The highest position of a servo, in pulses. The lowest is 0."""
    turn: int
    """How many pulses make a whole turn."""
    wheels: tuple[int, ...] = ()
    """The ids of the wheels' servos, if they are on the same bus as the arm. No joint may use these ids."""
    joint: Mapping[str, float] = {}
    """Default values for the settings of a joint, by key. Only defaults that differ from the usual ones are listed."""


class SteeringServo(Data):
    """The servo of a steered base, as the settings describe it."""

    kind: str
    """How the servo is connected: "pwm" or "bus"."""
    id: int
    centre: int
    """The pulses at which the wheels point straight ahead."""
    per_rad: float
    """How many pulses are added for one radian to the left. If it is negative, pulses are subtracted."""
    most_rad: float
    """The largest steering angle to each side, in radians."""


class Facts(Data):
    """The facts about one kind of board that failstop needs to read the settings."""

    speeds: int
    """How many speeds a frame sets, unless `layouts` lists the layout of the base."""
    imu: bool
    """True if the board has an IMU."""
    battery: bool = False
    """True if the board reports the voltage of its battery."""
    keys: bool = False
    """True if the board has keys, and reports them."""
    arm: ArmFacts | None = None
    """The arm's servos. None if the board has no servos for an arm."""
    steers: Mapping[str, tuple[int, int, int]] = {}
    """The kinds of servos that can steer a base on this board, such as "pwm", with (fewest pulses, most pulses, highest
    id) for each. Empty if the board can't steer."""
    no_steering: str = ""
    """Why the servo of a steered base may not move although all is connected, and what helps. Empty if nothing is
    known."""
    layouts: Mapping[str, int] = {}
    """How many speeds a frame sets, by the base's layout (the setting wheels.layout). Only layouts for which the number
    differs from `speeds` are listed."""
    most: int = 0
    """The most speeds that a frame can set. If the settings give a wheel a higher id than the layout needs, a frame has
    more speeds, up to this number. 0 means that no wheel can have a higher id."""
    steered_defaults: Mapping[str, float] = {}
    """Default values of settings for a steered base, by key. Only defaults that differ from the usual ones are
    listed."""
    can: bool = False
    """True if the board's second motor is connected by CAN. The setting board.can_id then has the id of that motor."""
    motors: Mapping[int, str] = {}
    """The name, in words for people, of each motor that has its own controller. The keys are the ids in the
    controllers' reports (wire.Health)."""
    defaults: Mapping[str, float] = {}
    """Default values of settings, by key. Only defaults that differ from the usual ones are listed."""
