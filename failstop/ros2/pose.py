"""Pose: continues the robot's pose after the service is restarted. Each run of the service counts from zero, but in ROS
the frame odom must not jump. Pure."""

from __future__ import annotations

from math import cos, pi, remainder, sin

from failstop.api.snapshot import Odometry


class Pose:
    """The pose over all runs of the service that this bridge has seen."""

    def __init__(self) -> None:
        self._run = ""
        self._start: Odometry | None = None
        """Where the present run began. None if it began at zero."""
        self._shown: Odometry | None = None
        self._moved = False
        """True if the pose of the present run is not zero."""

    def continued(self, run: str, sample: Odometry) -> Odometry:
        """The sample as it must be published: its pose continues that of the runs before. `run`: the name of the run
        that the sample is from. Motion while no service runs is not counted, because nobody measures it."""
        if run != self._run:
            self._run = run
            # A run in which nothing moved adds no error, even if it never got a report of the wheels.
            self._start = self._shown if self._moved else self._start
        self._moved = any((sample.x_m, sample.y_m, sample.th_rad))
        self._shown = _after(self._start, sample) if self._start else sample
        return self._shown


def _after(start: Odometry, sample: Odometry) -> Odometry:
    """The sample with its pose and covariance counted from where `start` counts from, and not from `start`."""
    ahead, aside = cos(start.th_rad), sin(start.th_rad)
    dx, dy = sample.x_m * ahead - sample.y_m * aside, sample.x_m * aside + sample.y_m * ahead
    moved = sample._replace(
        x_m=start.x_m + dx, y_m=start.y_m + dy, th_rad=remainder(start.th_rad + sample.th_rad, 2 * pi)
    )
    if sample.source == "commands":
        return moved  # its covariance is huge anyway
    xx, xy, xt, yy, yt, tt = start.pose_covariance
    # If the heading at the start is wrong by 1 rad, the whole way since then is turned to the side.
    turned = (
        xx - 2 * dy * xt + dy * dy * tt,
        xy - dy * yt + dx * xt - dx * dy * tt,
        xt - dy * tt,
        yy + 2 * dx * yt + dx * dx * tt,
        yt + dx * tt,
        tt,
    )
    xx, xy, xt, yy, yt, tt = sample.pose_covariance
    own = (
        ahead * ahead * xx - 2 * ahead * aside * xy + aside * aside * yy,
        ahead * aside * (xx - yy) + (ahead * ahead - aside * aside) * xy,
        ahead * xt - aside * yt,
        aside * aside * xx + 2 * ahead * aside * xy + ahead * ahead * yy,
        aside * xt + ahead * yt,
        tt,
    )
    return moved._replace(pose_covariance=tuple(a + b for a, b in zip(turned, own, strict=True)))
