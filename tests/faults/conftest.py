"""One board and one service for every row that they get over; inject_one() makes new ones when they did not."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.lab.faults.scene import Scene
from failstop.lab.trial import Trial
from tests.support.shared_trial import JUDGES_HZ


class Quiet(Scene):
    """A scene whose board's IMU says less: most of the time that it lives nothing but that wakes its processes."""

    def _new_trial(self) -> Trial:
        return Trial(self.name, ("--config", self._config), imu_hz=JUDGES_HZ)


@pytest.fixture(scope="package")
def scene() -> Iterator[Scene]:
    """Board, service and driving client of a campaign."""
    with Quiet(f"faults-{os.getpid()}") as found:
        yield found
