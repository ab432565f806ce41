"""A policy's program that ends or hangs: the board says that the wheels stand, and the arm, with its torque on."""

from __future__ import annotations

import os
import signal

import pytest

from failstop.board.rrc.framing import BUS_SERVO
from failstop.board.servos import SERVO_MOVE, SERVO_STOP
from failstop_lab.faults.arm import ArmTrial
from failstop_lab.trial import wait_for

from .scene import LeRobot, policy

ENDS = [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGSTOP]


@pytest.mark.parametrize("end", ENDS)
def test_the_wheels_stop_when_the_policy_s_program_ends(lerobot: LeRobot, trial: ArmTrial, end: signal.Signals) -> None:
    trial.robot.enable()
    with policy(lerobot, trial, "wheels") as program:
        trial.board.wait_wheels(turning=True, timeout_s=10.0)
        mark = trial.board.info()["executed"]
        os.kill(program.pid, end)
        stop = trial.board.wait_for(lambda event: event.is_motor and not any(event.speeds), 10.0, mark)
        hangs = end == signal.SIGSTOP
        wait_for("the gate's word", lambda: trial.robot.state.enabled == hangs and not trial.robot.state.moving)
        assert not [event for event in trial.board.events(stop.index + 1) if event.is_motion]


@pytest.mark.parametrize("end", ENDS)
def test_the_arm_is_held_when_the_policy_s_program_ends(lerobot: LeRobot, trial: ArmTrial, end: signal.Signals) -> None:
    with policy(lerobot, trial, "arm") as program:
        wait_for("the arm to move", lambda: (arm := trial.robot.state.arm) and arm.moving)
        mark = trial.board.info()["executed"]
        os.kill(program.pid, end)
        held = trial.board.wait_for(lambda event: event.func == BUS_SERVO and event.data[0] == SERVO_STOP, 10.0, mark)
        wait_for("the gate's word", lambda: (arm := trial.robot.state.arm) and not arm.mode)
        after = [event for event in trial.board.events(held.index + 1) if event.func == BUS_SERVO]
        assert not [event for event in after if event.data[0] == SERVO_MOVE]
        assert not trial.board.limp()
