"""The program of docs/questions.md that stops by a joystick, with the kernel's joystick events in a FIFO."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

from failstop_lab.trial import Trial, wait_for
from tests.support.pages import ROOT, blocks

PAGE = ROOT / "docs/questions.md"
BUTTON, AXIS, AT_OPENING = 1, 2, 0x80
"""Types of a `struct js_event` (linux/joystick.h); the last is added to the events that say how it is at first."""


def event(kind: int, number: int, value: int) -> bytes:
    """Time in ms, value, type, number."""
    return struct.pack("IhBB", 1000, value, kind, number)


def test_a_button_of_the_joystick_stops_the_robot_and_so_does_its_plug(trial: Trial, tmp_path: Path) -> None:
    [program] = [block.text for block in blocks(PAGE) if block.language == "python"]
    pad = tmp_path / "js0"
    os.mkfifo(pad)
    command = [sys.executable, "-c", program.replace("Robot()", f'Robot("{trial.name}")'), str(pad)]
    with subprocess.Popen(command) as running, pad.open("wb", buffering=0) as joystick:
        trial.enable()
        joystick.write(event(BUTTON | AT_OPENING, 3, 1) + event(AXIS, 0, 32767) + event(BUTTON, 3, 0))
        trial.drive(0.3)
        assert trial.turning()
        joystick.write(event(BUTTON, 3, 1))
        wait_for("the button's stop", lambda: trial.robot.state.estop)
        assert "joystick button 3" in str(trial.robot.state.estop)
        wait_for("the wheels to stop", lambda: not trial.turning())
        trial.reset()
        joystick.close()
        assert running.wait(10) == 0
    wait_for("the plug's stop", lambda: "the joystick is gone" in str(trial.robot.state.estop))
