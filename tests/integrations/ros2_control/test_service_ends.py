"""The service ends, or is not there yet: the hardware says so, and can be configured again."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from failstop_lab.trial import Trial

from .scene import drive, managed, needs_compiler, settings, urdf

pytestmark = [needs_compiler(), pytest.mark.slow]


@pytest.mark.parametrize("release", ["humble", "lyrical"])
def test_the_service_is_started_again(release: str, tmp_path: Path) -> None:
    name = f"ros2-again-{os.getpid()}"
    with Trial(name, settings(tmp_path, "arduino"), imu_hz=20.0, kind="arduino") as trial:
        (tmp_path / "manager").mkdir()
        with managed(release, urdf("diff", service=name), tmp_path / "manager") as manager:
            drive(manager, trial)
            trial.leave()
            trial.service.end()
            manager.until("on_error SUCCESS")
            assert manager.process.poll() is None
            trial.board.wait_wheels(turning=False, timeout_s=5.0)
            trial.service.start()
            manager.send("to configure", "to activate")
            manager.until("state active", 2)
            assert not trial.turning()
            drive(manager, trial)


@pytest.mark.parametrize("release", ["humble", "lyrical"])
def test_a_service_that_was_started_again_meanwhile_is_not_latched(release: str, tmp_path: Path) -> None:
    """The motion of the run that has ended is over, and the stop would be the next run's."""
    name = f"ros2-meanwhile-{os.getpid()}"
    with Trial(name, settings(tmp_path, "arduino"), imu_hz=20.0, kind="arduino") as trial:
        (tmp_path / "manager").mkdir()
        with managed(release, urdf("diff", service=name), tmp_path / "manager") as manager:
            drive(manager, trial)
            trial.leave()
            manager.signal(signal.SIGSTOP)
            trial.service.end()
            trial.service.start()
            manager.signal(signal.SIGCONT)
            manager.until("on_error SUCCESS")
            manager.send("to configure", "to activate")
            manager.until("state active", 2)
            assert trial.robot.state.estop is None
            assert not trial.turning()
            drive(manager, trial)


def test_a_service_that_comes_later_is_waited_for(tmp_path: Path) -> None:
    name = f"ros2-later-{os.getpid()}"
    (tmp_path / "manager").mkdir()
    with managed("lyrical", urdf("diff", service=name), tmp_path / "manager") as manager:
        manager.until("state unconfigured")
        with Trial(name, settings(tmp_path, "arduino"), imu_hz=20.0, kind="arduino") as trial:
            drive(manager, trial)
        assert "waiting up to 10 s for the service" in manager.logged


def test_a_service_that_is_not_there(tmp_path: Path) -> None:
    text = urdf("diff", service="ros2-nobody").replace(">10<", ">0<")
    with managed("lyrical", text, tmp_path) as manager:
        manager.until("on_configure FAILURE")
        manager.until("state unconfigured", 2)
        assert "diff_base: " in manager.logged
        assert "ros2-nobody" in manager.logged
