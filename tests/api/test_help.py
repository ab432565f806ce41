"""`help(failstop)`: its example drives a robot."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import failstop
from failstop_lab.trial import Trial


def test_the_example_drives_the_robot_and_leaves_it_disabled(trial: Trial) -> None:
    text = failstop.__doc__ or ""
    example = textwrap.dedent("\n".join(line for line in text.splitlines() if line.startswith("    ")))
    assert "robot.drive(" in example
    trial.robot.estop("before it")
    trial.robot.wait_for("latched", 5.0)
    trial.board.events()
    code = example.replace("Robot()", f"Robot({trial.name!r})")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    speeds = [event.speeds for event in trial.board.events() if event.is_motion]
    assert max(front_left for front_left, *_ in speeds) > 0.5, "revolutions per second, of 0.2 m/s"
    assert not trial.robot.state.enabled
    assert not trial.turning()
