"""LeKiwi itself: nine servos on one bus, joints by LeRobot's calibration file, wheels and arm at once."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator

import pytest
from lerobot_robot_failstop.__main__ import tables

from failstop.supervisor import status
from failstop_lab.trial import Trial, wait_for

from .scene import KIWI, LeRobot, policy

RANGES = ((760, 3380), (820, 3200), (850, 3080), (900, 3210), (0, 4095), (2030, 3490))
"""Of the joints, in the order of their servos."""
CALIBRATION = {
    name: {"id": servo, "drive_mode": 0, "homing_offset": 0, "range_min": low, "range_max": high}
    for (name, servo), (low, high) in zip(KIWI["servos"].items(), (*RANGES, *3 * [(0, 4095)]), strict=True)
}
SETTINGS = f"""
board.kind = "feetech"
scan.gate = "off"
arm.auto_tuck = "off"
{status.LEASE} = {status.LEASE_WITHOUT_S}
"""


@pytest.fixture(scope="module")
def kiwi(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    settings = tmp_path_factory.mktemp("kiwi") / "kiwi.toml"
    settings.write_text(SETTINGS + tables(CALIBRATION))
    with Trial(f"feetech-{os.getpid()}", ("--config", str(settings)), kind="feetech") as trial:
        yield trial


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_wheels_and_arm_stand_when_the_policy_ends(lerobot: LeRobot, kiwi: Trial, end: signal.Signals) -> None:
    (lerobot.home / KIWI["calibration folder"] / "kiwi.json").write_text(json.dumps(CALIBRATION))
    kiwi.robot.enable()
    with policy(lerobot, kiwi, "both") as program:
        kiwi.board.wait_wheels(turning=True, timeout_s=10.0)
        wait_for("the arm to move", lambda: (arm := kiwi.robot.state.arm) and arm.moving)
        mark = kiwi.board.info()["executed"]
        os.kill(program.pid, end)
        stop = kiwi.board.wait_for(lambda event: event.is_motor and not any(event.speeds), 10.0, mark)
        wait_for("the gate's word", lambda: (arm := kiwi.robot.state.arm) and not arm.mode and not arm.moving)
        kiwi.robot.disable()
        held = kiwi.robot.arm.read()
        assert kiwi.robot.arm.read() == held
        assert not [event for event in kiwi.board.events(stop.index + 1) if event.is_motion]
