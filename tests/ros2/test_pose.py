"""The pose that the bridge publishes does not jump when the service is restarted, judged by the service's own odometry
over the same way in one run."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api.snapshot import Odometry
from failstop.messages.records import ODOMETRY_FROM
from failstop.policy.settings import Settings
from failstop.procs.telemetry import odometry
from failstop.ros2.pose import Pose

MS = 1_000_000
HUGE = Odometry._field_defaults["pose_covariance"]


def sample(x_m: float, y_m: float = 0.0, th_rad: float = 0.0, source: Any = "wheels", **more: Any) -> Odometry:
    return Odometry(0, x_m, y_m, th_rad, 0.2, 0.1, 0.3, 0.05, 0.2, source, **more)


class Service:
    """One run of the service, whose four wheels are measured."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._odometry = odometry.Odometry(Settings())
        self._turns, self._t_ns = [0.0] * 4, 0
        self.roll((0.0,) * 4)

    def roll(self, steps: tuple[float, ...]) -> Odometry:
        """The wheels have made these turns."""
        self._turns = [turns + step for turns, step in zip(self._turns, steps, strict=True)]
        self._t_ns += 50 * MS
        self._odometry.roll(
            SimpleNamespace(  # type: ignore[arg-type]
                turns=tuple(self._turns), missed=0.0, t_ns=self._t_ns, step=0.0, counts=False, speeds_rps=(0.0,) * 4
            )
        )
        found = self._odometry
        source: Any = ODOMETRY_FROM[found.source]
        return sample(found.x_m, found.y_m, found.th_rad, source, pose_covariance=found.covariance)


def test_the_pose_and_its_covariance_are_those_of_one_run_without_a_restart() -> None:
    rng = random.Random(20261130)
    pose, one, present = Pose(), Service("one"), Service("present")
    for n in range(200):
        if n % 40 == 39:
            present = Service(f"present {n}")
            kept = pose.continued(present.name, present.roll((0.0,) * 4))
            assert kept[1:4] == pytest.approx(one.roll((0.0,) * 4)[1:4]), "it does not jump"
        steps = tuple(rng.uniform(-0.1, 0.2) for _ in range(4))
        wanted, found = one.roll(steps), pose.continued(present.name, present.roll(steps))
        assert found[1:4] == pytest.approx(wanted[1:4])
        assert found.pose_covariance == pytest.approx(wanted.pose_covariance)
    assert abs(found.th_rad) > 0.1
    assert found.pose_covariance[5] > 0.001


def test_the_first_run_is_published_as_it_is() -> None:
    pose = Pose()
    assert pose.continued("a", sample(0.0)) == sample(0.0)
    assert pose.continued("a", sample(1.0, 2.0, 3.0)) == sample(1.0, 2.0, 3.0)


def test_the_pose_of_commands_goes_on_too_and_stays_unsure() -> None:
    pose = Pose()
    pose.continued("a", sample(1.0, 2.0, 3.0, pose_covariance=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
    found = pose.continued("b", sample(0.0, source="commands"))
    assert (found[1:4], found.pose_covariance) == ((1.0, 2.0, 3.0), HUGE)
    assert found[4:10] == sample(0.0, source="commands")[4:10], "velocities are those of now"


def test_a_run_in_which_nothing_moved_makes_the_pose_no_less_sure() -> None:
    pose, small = Pose(), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)
    pose.continued("a", sample(1.0, pose_covariance=small))
    pose.continued("b", sample(0.0, source="commands"))
    found = pose.continued("c", sample(0.0, pose_covariance=(0.0,) * 6))
    assert (found.x_m, found.pose_covariance) == (1.0, small)
    pose.continued("c", sample(0.5, source="commands"))
    found = pose.continued("d", sample(0.0, pose_covariance=(0.0,) * 6))
    assert (found.x_m, found.pose_covariance) == (1.5, HUGE), "nobody knows how far it went by commands"
