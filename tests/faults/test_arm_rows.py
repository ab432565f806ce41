"""The arm's faults: each makes the arm stand in time, by the word of its servos; and what refuses motion by name."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.lab.faults import arm
from failstop.lab.faults.arm import ArmFault, ArmTrial
from tests.support.amounts import LONG

FEW = {"arm-kill-gate", "arm-kill-port_owner", "arm-hang-gate", "arm-client-killed", "arm-stop-request", "arm-usb-drop"}
ROWS = [row for row in arm.ROWS if LONG or row.name in FEW]


@pytest.fixture(scope="module")
def trial() -> Iterator[ArmTrial]:
    with ArmTrial(f"arm-rows-{os.getpid()}") as running:
        yield running


@pytest.mark.parametrize("fault", ROWS, ids=[row.name for row in ROWS])
def test_the_arm_stands(trial: ArmTrial, fault: ArmFault) -> None:
    rested = arm.strike(trial, fault)
    assert rested.wrong == ()


@pytest.mark.parametrize("fault", arm.SERVO_FAULTS if LONG else ("silent", "blocked"))
def test_a_faulty_servo_refuses_motion_by_name(trial: ArmTrial, fault: str) -> None:
    assert arm.refused_for(trial, fault) == ""


def test_every_process_has_its_rows() -> None:
    assert {row.process for row in arm.ROWS} - {""} == {"supervisor", "port_owner", "gate", "telemetry", "stopper"}
    assert len({row.name for row in arm.ROWS}) == len(arm.ROWS)
