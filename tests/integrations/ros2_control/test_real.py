"""The plugin in a real controller manager with diff_drive_controller: `make ros2-control`, where ROS 2 is installed."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.controller_manager import CLIENT, PLUGIN, run
from failstop_lab.trial import Trial
from tests.support.waiting import until

from .scene import settings, stopped, urdf

ROS = os.environ.get("FAILSTOP_ROS", "")
NAME = f"ros2-real-{os.getpid()}"
STARTS_S = 60.0
HUMBLE = "humble" in ROS
TOPIC, TYPE, VALUE = (
    ("cmd_vel_unstamped", "geometry_msgs/msg/Twist", "{linear: {x: 0.1}}")
    if HUMBLE
    else ("cmd_vel", "geometry_msgs/msg/TwistStamped", "{header: auto, twist: {linear: {x: 0.1}}}")
)
pytestmark = [pytest.mark.skipif(not ROS, reason="no ROS 2 (make ros2-control)"), pytest.mark.slow]


class Launched:
    """A process of ROS in a group of its own, which is ended whole."""

    def __init__(self, words: str, log: Path, overlay: Path) -> None:
        with open(log, "wb") as out:
            self._process = subprocess.Popen(
                ["bash", "-c", f". {ROS} && . {overlay}/install/setup.bash && exec {words}"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def end(self) -> None:
        for number in (signal.SIGINT, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, number)
                self._process.wait(10)
            except (ProcessLookupError, subprocess.TimeoutExpired):
                continue


@pytest.fixture(scope="module")
def overlay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("overlay")
    run("make", "--silent", "-C", CLIENT, f"BUILD={folder / 'client'}", f"PREFIX={folder / 'prefix'}", "install")
    built = (
        f"--build-base {folder}/build --install-base {folder}/install --cmake-args -DCMAKE_PREFIX_PATH={folder}/prefix"
    )
    run("bash", "-c", f". {ROS} && colcon --log-base {folder}/log build --base-paths {PLUGIN} {built}")
    return folder


@pytest.fixture(scope="module")
def driven(overlay: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    """A service and a launched controller manager, whose controller hears 0.1 m/s all the time."""
    folder = tmp_path_factory.mktemp("real")
    (folder / "base.urdf").write_text(urdf("diff", service=NAME))
    controllers = (PLUGIN / "config" / "diff.yaml").read_text()
    more = "    use_stamped_vel: false\n" if HUMBLE else ""
    (folder / "controllers.yaml").write_text(controllers + more)
    files = f"urdf:={folder}/base.urdf controllers:={folder}/controllers.yaml"
    with Trial(NAME, settings(folder, "arduino"), imu_hz=20.0, kind="arduino") as trial:
        launch = Launched(f"ros2 launch failstop_ros2_control failstop.launch.py {files}", folder / "launch", overlay)
        try:
            yield trial
        finally:
            launch.end()


@pytest.fixture
def commanded(driven: Trial, overlay: Path, tmp_path: Path) -> Iterator[Trial]:
    """The wheels turn."""
    end_s = time.monotonic() + STARTS_S
    while not manager(driven):
        assert time.monotonic() < end_s, "no controller manager has connected"
        time.sleep(0.1)
    driven.enable()
    words = f"ros2 topic pub --rate 20 /base_controller/{TOPIC} {TYPE} '{VALUE}'"
    publisher = Launched(words, tmp_path / "publisher", overlay)
    try:
        driven.board.wait_wheels(turning=True, timeout_s=STARTS_S)
        yield driven
    finally:
        publisher.end()


def manager(trial: Trial) -> int:
    """The pid of the controller manager, by the service; 0: it has not connected."""
    return next((client.pid for client in trial.robot.state.clients if client.name == "diff_base"), 0)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGINT, signal.SIGTERM])
def test_its_end_stops_the_wheels_and_the_next_one_moves_nothing(commanded: Trial, number: signal.Signals) -> None:
    pid = manager(commanded)
    commanded.board.events()
    fault_ns = time.monotonic_ns()
    os.kill(pid, number)
    seen = stopped(commanded, fault_ns)
    assert seen.still_ns is not None
    assert seen.motion_after == 0
    until(lambda: manager(commanded) not in (0, pid), "the controller manager that is started again")
    assert not commanded.robot.state.enabled
    assert not any(event.is_motion for event in commanded.board.events())


def test_its_hang_stops_the_wheels(commanded: Trial) -> None:
    pid = manager(commanded)
    commanded.board.events()
    fault_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGSTOP)
    try:
        seen = stopped(commanded, fault_ns)
        assert seen.still_ns is not None
        assert seen.motion_after == 0
    finally:
        os.kill(pid, signal.SIGKILL)
