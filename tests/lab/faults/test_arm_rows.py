"""The arm's faults: each makes the arm stand in time, by the word of its servos, or refuses motion by name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest

from failstop.messages.layout import PROCESS_NAMES
from failstop.policy import causes
from failstop_lab.faults import arm
from failstop_lab.faults.arm import ArmTrial
from failstop_lab.faults.arm_table import (
    ARM_FAULT_BY_NAME,
    BESIDE_ROWS,
    HANG,
    KILL,
    POSING,
    ROWS,
    SERVO_FAULT,
    ArmFault,
)
from failstop_lab.faults.fault import BY_NEW_RUN
from failstop_lab.faults.table import FAULT_BY_NAME as OTHERS
from failstop_lab.sim.servos import Leg
from failstop_lab.stopped import Stopped
from failstop_lab.trial import wait_for
from tests.support.amounts import LONG

FEW = {"arm-kill-gate", "arm-kill-port_owner", "arm-hang-gate", "arm-client-killed", "arm-stop-posing", "arm-usb-drop"}
FEW |= {"arm-second-client", "arm-servo-silent"}
TRIED = [row for row in ROWS if LONG or row.name in FEW]
BESIDE = [row for row in BESIDE_ROWS if LONG or row.name in FEW]
BY_NAME = {row.name: row for row in BESIDE_ROWS}
MS = 1_000_000
FAULT_NS = 1_000 * MS
DIED = causes.DIED("gate")


@pytest.fixture(scope="module")
def trial() -> Iterator[ArmTrial]:
    with ArmTrial(f"arm-rows-{os.getpid()}") as running:
        yield running


@pytest.fixture(scope="module")
def kiwi() -> Iterator[ArmTrial]:
    """An arm on the wheels' bus."""
    with ArmTrial(f"kiwi-rows-{os.getpid()}", kind="feetech") as running:
        yield running


@pytest.mark.parametrize("fault", TRIED, ids=[row.name for row in TRIED])
def test_row(trial: ArmTrial, fault: ArmFault) -> None:
    rested = arm.strike(trial, fault)
    assert rested.wrong == ()


@pytest.mark.parametrize("fault", BESIDE, ids=[row.name for row in BESIDE])
def test_row_beside_the_wheels(kiwi: ArmTrial, fault: ArmFault) -> None:
    rested = arm.strike(kiwi, fault)
    assert rested.wrong == ()


def test_a_stop_before_the_arm_moves_is_tried_again_and_told(trial: ArmTrial, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a machine that held up the service while the arm was at rest: the row is about another stop."""
    pose, begun = trial.pose, list[str]()

    def stopped_first() -> int:
        begun.append("stopped" if not begun else "")
        if begun[-1]:
            trial.robot.estop("before the arm moves")
            wait_for("the latch", lambda: bool(trial.robot.state.estop))
        return pose()

    monkeypatch.setattr(trial, "pose", stopped_first)
    monkeypatch.setattr(arm, "MOVES_S", 1.0)
    rested = arm.strike(trial, ARM_FAULT_BY_NAME["arm-stop-posing"])
    assert rested.wrong == ()
    assert rested.again == ("waited 1 s for the arm to move",)


def judged(row: ArmFault = BY_NAME["arm-kill-gate"], **changed: Any) -> tuple[str, ...]:
    """The faults of a run in which all was well but for what is given. Times are ms from the fault."""
    given: dict[str, Any] = {
        "stop_ms": 3,
        "motion_after": 0,
        "turned": True,
        "from_ms": -20,
        "to_ms": 30,
        "limp": [],
        "latched": DIED,
    }
    given |= changed
    ns = None if given["stop_ms"] is None else given["stop_ms"] * MS
    stopped = Stopped(FAULT_NS, ns, ns, ns, given["motion_after"], given["turned"])
    track = [Leg(3, FAULT_NS + given["from_ms"] * MS, 100, FAULT_NS + given["to_ms"] * MS, 200)]
    return arm.judge_beside(row, stopped, track, given["latched"], given["limp"], ()).wrong


def test_wheels_stop_and_the_arm_holds_or_the_row_fails() -> None:
    assert judged() == ()
    assert judged(stop_ms=None) == ("the wheels were not stopped",)
    assert judged(stop_ms=121) == ("the wheels were stopped after 121 ms, the limit is 120",)
    assert judged(motion_after=1) == ("1 motion frames after the stop",)
    assert judged(to_ms=164) == ()
    assert judged(to_ms=166) == ("a joint turned until 166 ms, the limit is 165",)
    assert judged(limp=[4]) == ("servo 4 has let go",)
    assert judged(latched=None) == ("latched: None",)
    assert judged(turned=False) == (arm.NOT_DRIVING,)
    assert judged(from_ms=-200, to_ms=-61) == (arm.NOT_TURNING,)
    assert judged(from_ms=-70, to_ms=-59) == ()


def test_an_unplugged_board_s_wheels_are_another_row_s() -> None:
    assert BY_NAME["arm-usb-drop"].wheels_ms is None
    assert judged(BY_NAME["arm-usb-drop"], stop_ms=None, latched=causes.DEVICE_LOST()) == ()
    assert {row.what for row in BESIDE_ROWS} == {row.what for row in ROWS} - {POSING, SERVO_FAULT}


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
