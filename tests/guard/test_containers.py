"""A guard and a driver in different containers: pid namespaces, mounts and pseudo-terminals of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.guard_scene import GuardScene, Process
from failstop_lab.trial import wait_for

UNSHARE = ("unshare", "--pid", "--mount", "--fork", "--kill-child=KILL")
OWN_PROC = (*UNSHARE, "--mount-proc")
ENTER = """
mount --bind "$1" "$2"
mount -t devpts -o newinstance devpts /dev/pts
shift 2
exec "$@"
"""
"""The port is mounted at a place of the container's own, as a container engine does it with a volume."""
RATE = "30"


def _allowed() -> bool:
    if shutil.which("unshare") is None or os.geteuid() != 0:
        return False
    words = [*OWN_PROC, "mount", "-t", "devpts", "-o", "newinstance", "devpts", "/dev/pts"]
    return subprocess.run(words, check=False, stderr=subprocess.DEVNULL).returncode == 0


pytestmark = pytest.mark.skipif(not _allowed(), reason="needs root, and leave to make namespaces")


@pytest.fixture(params=["the machine", "a container"])
def scene(request: pytest.FixtureRequest, _arduino: GuardScene) -> Iterator[GuardScene]:
    """A service with a guard that runs there."""
    _arduino.trial.robot.disable()
    _arduino.start_guard(*(OWN_PROC if request.param == "a container" else ()))
    _arduino.rest()
    yield _arduino
    _arduino.end_drivers()
    _arduino.start_guard()


def contained(scene: GuardScene, place: Path, *driver: str) -> Process:
    """A driver in a container of its own, which finds the port at `place`."""
    place.touch()
    return scene.driver(*OWN_PROC, "sh", "-ec", ENTER, "sh", scene.path, str(place), *driver)


@pytest.mark.claim("GUARD-1")
def test_a_driver_in_another_container_drives_and_its_death_stops_it(
    scene: GuardScene, diffdrive: str, tmp_path: Path
) -> None:
    place = tmp_path / "ttyUSB0"
    for _ in range(2):
        scene.rest()
        scene.enable()
        driver = contained(scene, place, diffdrive, str(place), "serial", "10", "10", RATE)
        assert driver.line() == "start Invalid Command|OK"
        scene.moves()
        assert scene.trial.robot.state.driver
        driver.kill()
        scene.stands()
        wait_for("motion to be disabled", lambda: not scene.trial.robot.state.enabled)
        assert "died after it had driven" in str(scene.trial.robot.why())


def test_in_a_container_the_next_driver_gets_the_port_after_one_that_had_a_child(
    scene: GuardScene, diffdrive: str
) -> None:
    """The child was seen with the port, and neither its beginning nor its end is an event of the kernel's."""
    ended = scene.python(
        "import os, sys, time\n"
        "port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "if os.fork():\n"
        "    other = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "    time.sleep(0.3)\n"
        "    print('seen', flush=True)\n"
        "else:\n"
        "    time.sleep(0.2)\n"
    )
    assert ended.line() == "seen"
    ended.child.wait()
    assert scene.guard
    scene.guard.until("has ended")
    scene.rest()
    scene.enable()
    scene.driver(diffdrive, scene.path, "serial", "10", "10", RATE)
    scene.moves()
