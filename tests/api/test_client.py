"""A client's side of shared memory: when it wakes the gate, and what it leaves alone at its end."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from failstop.api import client as client_module
from failstop.api.client import REPEAT_NS, Client
from failstop.shm import bell
from failstop_lab.trial import Trial

MS = 1_000_000


def test_what_repeats_the_command_just_before_it_wakes_nobody(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    rings: list[bytes] = []
    now_ns = 0
    client = Client(trial.name, "test")
    send = bell.send

    def noted(fd: int, hint: bytes) -> None:
        rings.append(hint)
        send(fd, hint)

    monkeypatch.setattr(bell, "send", noted)
    monkeypatch.setattr(client_module, "monotonic_ns", lambda: now_ns)

    def rung(vx_mps: float, elapsed_ns: int, *, manual: bool = False, source: str = "cmd_vel") -> bool:
        nonlocal now_ns
        now_ns += elapsed_ns
        rings.clear()
        client.command(vx_mps, 0.0, 0.0, manual=manual, source=source)
        return bool(rings)

    assert rung(0.1, 0)
    assert not rung(0.1, 20 * MS)
    assert not rung(0.1, REPEAT_NS)
    assert rung(0.1, REPEAT_NS + 1), "a pause"
    assert rung(0.2, 20 * MS)
    assert rung(0.1, 20 * MS)
    assert rung(0.1, 20 * MS, manual=True)
    assert rung(0.1, 20 * MS, source="nav")
    assert not rung(0.1, 20 * MS, source="nav")
    monkeypatch.undo()
    client.close()


def test_files_that_get_the_numbers_of_closed_descriptors_are_left_alone(trial: Trial, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.write_bytes(b"mine" * 5000)
    program = f"""
import os
from failstop import Robot

robot = Robot({trial.name!r})
robot.drive(0.0, 0.0, 0.0, wait_s=0)
os.closerange(3, 64)
files = [os.open({str(own)!r}, os.O_RDWR) for _ in range(40)]
robot.close()
os._exit(0)
"""
    subprocess.run((sys.executable, "-c", program), check=True)
    assert own.read_bytes() == b"mine" * 5000


@pytest.mark.parametrize("driven", [False, True])
def test_a_program_that_has_closed_all_descriptors_goes_on_with_its_robot(trial: Trial, driven: bool) -> None:
    program = f"""
import os
from failstop import Robot

robot = Robot({trial.name!r})
robot.state
if {driven}:
    robot.drive(0.0, 0.0, 0.0, wait_s=0)
os.closerange(3, 64)
for _ in range(3):
    robot.drive(0.0, 0.0, 0.0, wait_s=0)
    print(robot.state.enabled)
robot.close()
"""
    done = subprocess.run((sys.executable, "-c", program), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "False\n" * 3, "")


@pytest.mark.parametrize("closes", ["atexit.register(robot.close)", "pass"])
def test_a_robot_that_is_closed_at_exit_has_ended_cleanly(trial: Trial, closes: str) -> None:
    """Without close(), it counts as dead."""
    trial.robot.wait_for("ready", 5.0)
    trial.robot.enable()
    program = f"""
import atexit, time
from failstop import Robot

robot = Robot({trial.name!r}, disable_on_exit=False)
{closes}
for _ in range(5):
    robot.sensed()
    robot.drive(0.0, 0.0, 0.0)
    time.sleep(0.02)
"""
    done = subprocess.run((sys.executable, "-c", program), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    if closes == "pass":
        trial.robot.wait_for("disabled", 5.0)
        return
    assert trial.robot.state.enabled
    trial.robot.drive(0.0, 0.0, 0.0)  # a further decision of the gate, which has read the goodbye by then
    assert trial.robot.state.enabled
