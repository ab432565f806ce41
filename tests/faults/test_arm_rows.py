"""The arm's faults: each makes the arm stand in time, by the word of its servos, or refuses motion by name."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.lab.faults import arm
from failstop.lab.faults.arm import ArmTrial
from failstop.lab.faults.arm_table import ARM_FAULT_BY_NAME, HANG, KILL, ROWS, ArmFault
from failstop.lab.faults.fault import BY_NEW_RUN
from failstop.lab.faults.table import FAULT_BY_NAME as OTHERS
from failstop.messages.layout import PROCESS_NAMES
from tests.support.amounts import LONG

FEW = {"arm-kill-gate", "arm-kill-port_owner", "arm-hang-gate", "arm-client-killed", "arm-stop-posing", "arm-usb-drop"}
FEW |= {"arm-second-client", "arm-servo-silent"}
TRIED = [row for row in ROWS if LONG or row.name in FEW]


@pytest.fixture(scope="module")
def trial() -> Iterator[ArmTrial]:
    with ArmTrial(f"arm-rows-{os.getpid()}") as running:
        yield running


@pytest.mark.parametrize("fault", TRIED, ids=[row.name for row in TRIED])
def test_row(trial: ArmTrial, fault: ArmFault) -> None:
    rested = arm.strike(trial, fault)
    assert rested.wrong == ()


def test_every_process_has_its_rows_and_every_row_a_name_of_its_own() -> None:
    for what in (KILL, HANG):
        assert {row.process for row in ROWS if row.what == what} == set(PROCESS_NAMES)
    assert len(ARM_FAULT_BY_NAME) == len(ROWS)
    assert not set(ARM_FAULT_BY_NAME) & set(OTHERS)


def test_every_row_is_in_order() -> None:
    for fault in ROWS:
        assert fault.name.startswith("arm-")
        assert (fault.bar_ms is None) == bool(fault.servo) == bool(fault.refused), fault.name
        assert not (fault.cleared == BY_NEW_RUN and fault.latched), fault.name
