"""Scale: converts the wheel speeds that a driver writes to a velocity of the base, as the service accepts it. Pure."""

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
"""Each speed is increased by this share of a step. The service rounds speeds towards zero to a multiple of the board's
step. The driver's speed is such a multiple already. Without the increase it could lose a whole step, because the
velocity that is computed from it may be a tiny bit too small."""
_ROUNDING = 1.001
AXES = (
    ("limits.vx_mps", "forward or backward", "m/s"),
    ("limits.vy_mps", "sideways", "m/s"),
    ("limits.wz_radps", "turning", "rad/s"),
)


class Scale:
    """Converts speeds using the wheels in the settings. It is the inverse of how the service converts a velocity to
    speeds."""

    def __init__(self, settings: Settings, per_rps: float, step_rps: float, *, assumed: bool = False) -> None:
        """`per_rps`: how many of the board's speed units are one turn of a wheel per second. `step_rps`: the smallest
        difference between two speeds of the board, turns per second. `assumed`: True if nobody has confirmed `per_rps`,
        so the limits are lower."""
        self._chassis = from_settings(settings)
        self.wheels = len(self._chassis.rest) - self._chassis.steers
        self._limits = [settings[key] for key, *_ in AXES]
        self._assumed = assumed
        self._per_rps, self._nudge_rps = per_rps, step_rps * _NUDGE

    def velocity(self, speeds: Sequence[float], steering_rad: float | None = None) -> Velocity:
        """The velocity of a base whose wheels turn at these speeds, given by wire id in the board's unit.
        `steering_rad`: the angle of the steered wheels, or None if the wheels' speeds determine how the base turns."""
        rps = [speed / self._per_rps + copysign(self._nudge_rps, speed) if speed else 0.0 for speed in speeds]
        vx, vy, wz = self._chassis.velocity(rps)
        if steering_rad is not None and isinstance(self._chassis, Steered):
            wz = self._chassis.turn_radps(vx, steering_rad)
        return vx, vy, wz

    def beyond(self, velocity: Velocity) -> str:
        """A text about a velocity beyond the settings' limits, which says what is commanded and what the limit is.
        Empty if the velocity is within the limits."""
        for asked, most, (key, way, unit) in zip(velocity, self._limits, AXES, strict=True):
            if abs(asked) > most * _ROUNDING:
                capped = self._assumed and most == scale.CAPS[key]
                why = f"because {scale.ASSUMED}; {scale.REMEDY}" if capped else f"which the setting {key} allows"
                return f"{abs(asked):.2f} {unit} {way} and gets {most:g}, {why}"
        return ""
