"""The program of the page drives the simulated robot."""

from __future__ import annotations

from failstop_lab.faults.arm import ArmTrial

from .scene import LeRobot, of_the_page


def test_the_page_s_program_drives_the_base_and_leaves_it_standing(lerobot: LeRobot, trial: ArmTrial) -> None:
    trial.robot.enable()
    mark = trial.board.info()["executed"]
    lerobot.run("-c", of_the_page("for _ in range(60)", trial.name))
    assert [event for event in trial.board.events(mark) if event.is_motion]
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
