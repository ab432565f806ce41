"""Scale: converts the wheel speeds that a driver writes into a velocity of the base, because the service accepts only
velocities. Pure."""

from __future__ import annotations

from math import copysign

from failstop.policy import scale
from failstop.policy.kinematics import Steered, from_settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.policy.kinematics import Velocity
    from failstop.policy.settings import Settings

_NUDGE = 1e-3
"""The guard makes each speed larger by this fraction of the board's speed step. The driver's speeds are whole steps,
but the velocity computed from them may be a tiny bit too small. The service rounds down, so without the increase a
wheel could turn a whole step slower."""
_ROUNDING = 1.001
AXES = (
    ("limits.vx_mps", "forward or backward", "m/s"),
    ("limits.vy_mps", "sideways", "m/s"),
    ("limits.wz_radps", "turning", "rad/s"),
)


class Scale:
    """Converts wheel speeds to a velocity. This reverses the service's conversion, with the wheels in the settings."""

    def __init__(self, settings: Settings, per_rps: float, step_rps: float, *, assumed: bool = False) -> None:
        """`per_rps`: how many of the board's speed units make one wheel turn per second. `step_rps`: the smallest
        difference between two speeds of the board, turns per second. `assumed`: True if nobody has confirmed `per_rps`,
        so that the limits in `settings` are lower."""
        self._chassis = from_settings(settings)
        self.wheels = len(self._chassis.rest) - self._chassis.steers
        self._limits = [settings[key] for key, *_ in AXES]
        self._assumed = assumed
        self._per_rps, self._nudge_rps = per_rps, step_rps * _NUDGE

    def velocity(self, speeds: Sequence[float], steering_rad: float | None = None) -> Velocity:
        """The velocity of a base whose wheels turn at `speeds`. `speeds`: by wire id, in the board's unit.
        `steering_rad`: the angle of the steered wheels, or None if the wheels' speeds determine how the base turns."""
        rps = [speed / self._per_rps + copysign(self._nudge_rps, speed) if speed else 0.0 for speed in speeds]
        vx, vy, wz = self._chassis.velocity(rps)
        if steering_rad is not None and isinstance(self._chassis, Steered):
            wz = self._chassis.turn_radps(vx, steering_rad)
        return vx, vy, wz

    def beyond(self, velocity: Velocity) -> tuple[str, str]:
        """Return (the setting of the limit, a text with the commanded speed and the limit) if the velocity is beyond
        one of the settings' limits. Otherwise both are empty."""
        for asked, most, (key, way, unit) in zip(velocity, self._limits, AXES, strict=True):
            if abs(asked) > most * _ROUNDING:
                capped = self._assumed and most == scale.CAPS[key]
                why = f"because {scale.ASSUMED}; {scale.REMEDY}" if capped else f"which the setting {key} allows"
                return key, f"{abs(asked):.2f} {unit} {way} and gets at most {most:g}, {why}"
        return "", ""
