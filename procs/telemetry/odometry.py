"""Wheel odometry. Pure. No encoders report, so it integrates what the gate commands: dead reckoning."""

from __future__ import annotations

from math import cos, pi, remainder, sin

from failstop.policy.settings import Settings

LONGEST_STEP_NS = 100_000_000
"""More time than this between two looks does not count: nobody knows what the wheels did in it."""


class Odometry:
    """The pose since the start: x, y in m, th in rad from -pi to pi; and the twist in the robot's own frame."""

    def __init__(self, settings: Settings) -> None:
        # How much of a commanded speed mecanum wheels make good: here only, never in what the motors are sent.
        self._forward_scale = settings["odometry.forward_scale"]
        self._sideways_scale = settings["odometry.sideways_scale"]
        self.twist_std = (settings["odometry.twist_std_mps"], settings["odometry.twist_std_radps"])
        """m/s of vx and vy, rad/s of wz, to publish with the twist."""
        self._last_ns: int | None = None
        self.x_m = self.y_m = self.th_rad = 0.0
        self.vx_mps = self.vy_mps = self.wz_radps = 0.0

    def inherit(self, x_m: float, y_m: float, th_rad: float) -> None:
        """Go on from where an earlier run of this process had come to."""
        self.x_m, self.y_m, self.th_rad = x_m, y_m, remainder(th_rad, 2 * pi)

    def follow(self, velocity: tuple[float, float, float], t_ns: int) -> None:
        """From `t_ns` on the gate commands another velocity (m/s, m/s, rad/s)."""
        self.advance(t_ns)
        vx, vy, self.wz_radps = velocity
        self.vx_mps = vx * self._forward_scale
        self.vy_mps = vy * self._sideways_scale

    def advance(self, now_ns: int) -> None:
        """Integrate the present velocity up to now, along the heading in the middle of the step."""
        if self._last_ns is None:
            self._last_ns = now_ns
        elapsed_ns = now_ns - self._last_ns
        if elapsed_ns <= 0:
            return
        self._last_ns = now_ns
        dt_s = min(elapsed_ns, LONGEST_STEP_NS) * 1e-9
        turned_rad = self.wz_radps * dt_s
        middle_rad = self.th_rad + turned_rad / 2
        ahead, aside = cos(middle_rad), sin(middle_rad)
        self.x_m += (self.vx_mps * ahead - self.vy_mps * aside) * dt_s
        self.y_m += (self.vx_mps * aside + self.vy_mps * ahead) * dt_s
        self.th_rad = remainder(self.th_rad + turned_rad, 2 * pi)
