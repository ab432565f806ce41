"""Servos: an arm and its joints, and each servo of a bus, as a service tells of them."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class JointState:
    """One joint of the arm."""

    servo: int
    """The id of its servo on the bus."""
    angle_rad: float | None
    """Measured, rad; None before a reading."""
    pulses: int | None
    """Its position in the servo's pulses."""
    age_s: float | None
    """Since it was read, s."""
    commanded_rad: float | None
    """Where it was sent, rad; None while it is not known where it is."""
    torque: bool | None
    """It holds; None: not known yet."""
    temperature_c: int | None
    """Of the servo, degrees Celsius."""
    supply_v: float | None
    """Of the servo, V."""

    @property
    def at_rad(self) -> float | None:
        """Where it is as far as is known, rad: sent (no servo is asked while it moves), or read to be."""
        return self.angle_rad if self.commanded_rad is None else self.commanded_rad


@dataclasses.dataclass(frozen=True)
class ArmState:
    """The arm."""

    mode: str
    """trajectory, follow, jog, or empty."""
    phase: str
    """How far a trajectory is."""
    moving: bool
    """It moves now."""
    by: str
    """The program that moves it; empty: none."""
    closed: str
    """Why it takes no goal; empty: it takes one."""
    refused: str
    """Why the last goal of a stream was not taken; empty: it was."""
    released: bool
    """Its torque is off."""
    silent: tuple[int, ...]
    """Servos that do not answer."""
    wrong: tuple[str, ...]
    """Faults of it, in words."""
    pose: str
    """drive, tuck, or empty."""
    auto_tuck_s: float | None
    """Until it tucks itself, s; None: it does not."""
    pad_joint: str | None
    """The joint that the gamepad turns."""
    joints: dict[str, JointState]
    """By name."""


@dataclasses.dataclass(frozen=True)
class ServoState:
    """A servo of a bus that the wheels share with the arm, as it says itself."""

    name: str
    """For people: `rear wheel (servo 8)`, `joint elbow (servo 3)`."""
    load: float
    """A share of the most that it gives, negative the other way round."""
    temperature_c: int | None
    """Degrees Celsius; None: not told yet."""
    hot: bool
    """As hot as the setting arm.hot_c."""
