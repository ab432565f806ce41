"""Wheel odometry: computes the robot's pose from the wheels' reports. Pure.

Until the first usable report, the pose is computed from the gate's commands instead (dead reckoning). Do not rely on
that pose. After the first usable report, only reports are used.
"""

from __future__ import annotations

import contextlib
from collections import deque
from math import cos, pi, remainder, sin

from failstop.messages.records import BY_COMMANDS, BY_ROLLING, POSE_VARIANCE
from failstop.policy import kinematics
from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.procs.telemetry.wheels import Measured

    Covariance = tuple[float, float, float, float, float, float]

LONGEST_STEP_NS = 100_000_000
"""The longest time that one call of advance() adds up, in ns. If more time has passed since the last call, the rest is
left out, because nobody knows what the wheels did in such a long gap."""
MEAN_NS = 200_000_000
"""If the board reports positions, the speeds are averaged over this time, in ns. Over only 50 ms, a single count of an
encoder may change the speed by 0.2 m/s."""
SLIP = {"differential": 0.02, ACKERMANN: 0.02, "omni3": 0.05, "mecanum": 0.05}
"""How much a wheel slips, by layout: the standard deviation of its distance after 1 m, in m. The standard deviation
grows with the square root of the distance. Wheels with rollers slip more: on a carpet, a mecanum base that goes
sideways moves only 0.765 of the distance that its wheels roll."""
DEAD_RECKONING: Covariance = (POSE_VARIANCE, 0.0, 0.0, POSE_VARIANCE, 0.0, POSE_VARIANCE)


class Odometry:
    """Computes the pose since the start (x, y in m; th in rad from -pi to pi), and the velocity in the robot's own
    frame."""

    def __init__(self, settings: Settings) -> None:
        # The share of the rolled or commanded distance that the base really moves. It is used only here, and never
        # affects what the motors are sent.
        self._scales = (settings["odometry.forward_scale"], settings["odometry.sideways_scale"], 1.0)
        self.twist_std = (settings["odometry.twist_std_mps"], settings["odometry.twist_std_radps"])
        """The standard deviations to publish with the velocity: m/s for vx and vy, rad/s for wz."""
        self._last_ns: int | None = None
        self.x_m = self.y_m = self.th_rad = 0.0
        self.vx_mps = self.vy_mps = self.wz_radps = 0.0
        self.source = BY_COMMANDS
        """What the pose is computed from: BY_ROLLING or BY_COMMANDS."""
        self._covariance = DEAD_RECKONING
        """The covariance of x, y (m2) and th (rad2), as xx, xy, x th, yy, y th, th th. The rounding error is not
        included."""
        self._rounded = 0.0
        """The variance of a wheel's turns that comes from counting in whole steps. It does not grow with the
        distance."""
        self._ways: tuple[tuple[float, ...], ...] = ()
        """How far one turn of each wheel, by wire id, moves the base along x, y (m) and th (rad)."""
        base = kinematics.from_settings(settings)
        with contextlib.suppress(ValueError):  # the motion can't be computed for this base, so only commands count
            self._ways = tuple(
                tuple(scale * each for each in row) for scale, row in zip(self._scales, base.rolled(), strict=True)
            )
        self._errors = self._ways
        """By how much x, y and th are wrong if the turns of a wheel are wrong by one, in the form of `_ways`. The
        numbers differ from `_ways` only for a steered base with one driven wheel."""
        self._bend = 0.0
        """How far the base turns per meter at the commanded steering angle, rad/m. Only used for a steered base with
        one driven wheel."""
        self._bends = isinstance(base, kinematics.Steered) and base.turns_unseen
        if self._bends:
            aside = tuple(each / settings["wheels.wheelbase_m"] for each in self._ways[0])
            self._errors = (*self._ways[:2], aside)
        rim_m = pi * settings["wheels.diameter_m"]
        self._slip_turns2 = SLIP[settings.text("wheels.layout")] ** 2 / rim_m
        """The variance that slip adds to a wheel's turns with each turn of the wheel, in turns squared."""
        self._told_m = self._told_rad = 0.0
        """The distance (m) and the angle (rad) that were commanded until now. Motion in either direction adds to
        them."""
        self._turns: tuple[float, ...] = ()
        self._missed = 0.0
        self._recent: deque[tuple[int, float, float, float]] = deque()
        """One entry for each report of the last MEAN_NS: when it came, and how far the base had moved by then (x, y,
        th), along the base's own axes."""
        self._gone = (0.0, 0.0, 0.0)

    @property
    def t_ns(self) -> int:
        """The time of the pose, CLOCK_MONOTONIC ns."""
        return self._last_ns or 0

    @property
    def covariance(self) -> Covariance:
        """The covariance of x, y (m2) and th (rad2), as xx, xy, x th, yy, y th, th th."""
        xx, xy, xt, yy, yt, tt = self._covariance
        if self._rounded:
            x, y, th = (self._rounded * sum(way * way for way in row) for row in self._ways)
            xx, yy, tt = xx + x + y, yy + x + y, tt + th
        return xx, xy, xt, yy, yt, tt

    def inherit(
        self,
        x_m: float,
        y_m: float,
        th_rad: float,
        source: int = BY_COMMANDS,
        covariance: Covariance = DEAD_RECKONING,
        measured: Measured | None = None,
    ) -> None:
        """Continue from the pose of an earlier telemetry process. `measured`: the wheels, as that process knew them."""
        self.x_m, self.y_m, self.th_rad = x_m, y_m, remainder(th_rad, 2 * pi)
        self.source, self._covariance = source, covariance
        if measured and source == BY_ROLLING:
            self._turns, self._missed, self._last_ns = measured.turns, measured.missed, measured.t_ns

    def follow(self, velocity: tuple[float, float, float], t_ns: int) -> None:
        """Record that the gate commands this velocity (m/s, m/s, rad/s) from `t_ns` on."""
        if self._bends and velocity[0]:  # a stop leaves the steering as it is
            self._bend = velocity[2] / velocity[0]
        if self.source == BY_ROLLING:
            return
        self.advance(t_ns)
        vx, vy, self.wz_radps = velocity
        self.vx_mps = vx * self._scales[0]
        self.vy_mps = vy * self._scales[1]

    def advance(self, now_ns: int) -> None:
        """Add the commanded motion up to `now_ns`, at most LONGEST_STEP_NS of it. Does nothing once reports are
        used."""
        if self.source == BY_ROLLING:
            return
        if self._last_ns is None:
            self._last_ns = now_ns
        elapsed_ns = now_ns - self._last_ns
        if elapsed_ns <= 0:
            return
        self._last_ns = now_ns
        dt_s = min(elapsed_ns, LONGEST_STEP_NS) * 1e-9
        self._told_m += (abs(self.vx_mps) + abs(self.vy_mps)) * dt_s
        self._told_rad += abs(self.wz_radps) * dt_s
        self._move(self.vx_mps * dt_s, self.vy_mps * dt_s, self.wz_radps * dt_s)

    def _move(self, ahead_m: float, aside_m: float, turned_rad: float) -> tuple[float, float]:
        """Move the pose by this distance and turn, along the heading at the middle of the move. Returns that heading's
        cosine and sine."""
        middle_rad = self.th_rad + turned_rad / 2
        ahead, aside = cos(middle_rad), sin(middle_rad)
        self.x_m += ahead_m * ahead - aside_m * aside
        self.y_m += ahead_m * aside + aside_m * ahead
        self.th_rad = remainder(self.th_rad + turned_rad, 2 * pi)
        return ahead, aside

    def roll(self, measured: Measured) -> None:
        """Move the pose by the wheels' turns since the last report. Call this for each new report."""
        turns, missed, t_ns = measured.turns, measured.missed, measured.t_ns
        if not turns or len(turns) != len(self._ways[0] if self._ways else ()):
            return  # the report has a different number of wheels than this robot
        if self.source == BY_COMMANDS:
            self.source = BY_ROLLING
            # It is not known how much of the distance commanded until now was really driven.
            way, turn = self._told_m**2, self._told_rad**2
            self._covariance = (way, 0.0, 0.0, way, 0.0, turn)
            self._last_ns = t_ns
        # The distance is the difference of two counts, and each count is rounded by up to one step.
        self._rounded = measured.step**2 / 6
        before, self._turns = self._turns, turns
        lost, self._missed = missed - self._missed, missed
        if len(before) == len(turns):
            self._go([now - then for now, then in zip(turns, before, strict=True)], max(0.0, lost))
        self._use_speeds(measured)
        self._last_ns = max(t_ns, self._last_ns or 0)

    def _go(self, steps: Sequence[float], lost: float) -> None:
        """Move the pose by `steps`, the turns of each wheel. `lost`: how many turns each wheel may have made unseen."""
        dx, dy, dth = (sum(way * step for way, step in zip(row, steps, strict=True)) for row in self._ways)
        dth += dx * self._bend
        self._gone = (self._gone[0] + dx, self._gone[1] + dy, self._gone[2] + dth)
        if not lost and not any(steps):
            return
        # The straight distance (the chord of the arc) is shorter than the driven one.
        share = sin(dth / 2) / (dth / 2) if dth else 1.0
        dx, dy = dx * share, dy * share
        ahead, aside = self._move(dx, dy, dth)
        variances = [self._slip_turns2 * abs(step) + lost * lost for step in steps]
        self._grow(ahead, aside, dx, dy, variances)

    def _grow(self, ahead: float, aside: float, dx: float, dy: float, variances: Sequence[float]) -> None:
        """Increase the covariance after a move of (`dx`, `dy`) in the robot's frame. `variances`: the variance of each
        wheel's turns."""
        xs, ys, ths = self._errors
        # If the heading is wrong by 1 rad, the whole distance is turned to the side.
        out_x, out_y = -(dx * aside + dy * ahead), dx * ahead - dy * aside
        xx, xy, xt, yy, yt, tt = self._covariance
        xx, xy, yy = (
            xx + 2 * out_x * xt + out_x * out_x * tt,
            xy + out_x * yt + out_y * xt + out_x * out_y * tt,
            yy + 2 * out_y * yt + out_y * out_y * tt,
        )
        xt, yt = xt + out_x * tt, yt + out_y * tt
        for x, y, th, variance in zip(xs, ys, ths, variances, strict=True):
            # The heading at the middle of the move has half of the turn's error.
            gx = x * ahead - y * aside + out_x * th / 2
            gy = x * aside + y * ahead + out_y * th / 2
            xx, xy, xt = xx + gx * gx * variance, xy + gx * gy * variance, xt + gx * th * variance
            yy, yt, tt = yy + gy * gy * variance, yt + gy * th * variance, tt + th * th * variance
        self._covariance = (xx, xy, xt, yy, yt, tt)

    def _use_speeds(self, measured: Measured) -> None:
        if not measured.counts:
            self.vx_mps, self.vy_mps, self.wz_radps = (
                sum(way * rps for way, rps in zip(row, measured.speeds_rps, strict=True)) for row in self._ways
            )
            self.wz_radps += self.vx_mps * self._bend
            return
        recent, t_ns = self._recent, measured.t_ns
        while len(recent) > 1 and recent[1][0] <= t_ns - MEAN_NS:
            recent.popleft()
        if recent and t_ns > recent[0][0]:
            since_ns, *gone = recent[0]
            self.vx_mps, self.vy_mps, self.wz_radps = (
                (now - then) * 1e9 / (t_ns - since_ns) for now, then in zip(self._gone, gone, strict=True)
            )
        if not recent or t_ns > recent[-1][0]:
            recent.append((t_ns, *self._gone))
