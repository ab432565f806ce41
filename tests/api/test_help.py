"""`help(failstop)`: its example drives a robot."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from subprocess import PIPE

import failstop
from failstop_lab.trial import Trial


def test_the_example_waits_for_a_person_drives_and_ends_with_the_reason(trial: Trial) -> None:
    text = failstop.__doc__ or ""
    example = textwrap.dedent("\n".join(line for line in text.splitlines() if line.startswith("    ")))
    assert "robot.drive(" in example
    trial.robot.estop("before it")
    trial.robot.wait_for("latched", 5.0)
    trial.board.events()
    code = example.replace("Robot()", f"Robot({trial.name!r})")
    with subprocess.Popen([sys.executable, "-c", code], stdout=PIPE, stderr=PIPE, text=True) as program:
        try:
            trial.enable()
            trial.robot.wait_for(lambda state: state.body_vel.vx_mps > 0.19, 30.0)
            trial.robot.estop("that will do")
            said, wrong = program.communicate(timeout=60)
        finally:
            program.kill()
    assert (program.returncode, wrong) == (0, "")
    assert "that will do" in said
    speeds = [event.speeds for event in trial.board.events() if event.is_motion]
    assert max(front_left for front_left, *_ in speeds) > 0.5, "revolutions per second, of 0.2 m/s"
    assert not trial.robot.state.enabled
    assert not trial.turning()
