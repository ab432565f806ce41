"""The arm through all processes, on the simulated machine and its board: the servos say where it is. Its rules are in
tests/procs."""

from __future__ import annotations

import re

import pytest

from failstop.board.rrc.framing import BUS_SERVO
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.simulated import Simulated

PULSES = 238.73
"""Pulses of a servo for a radian."""
SETTINGS = ARM


@pytest.fixture
def arm(simulated: Simulated) -> Simulated:
    return simulated


def test_move_goes_there_and_is_read_back(arm: Simulated) -> None:
    arm.robot.arm.move({"base": 0.5, "wrist": -0.3})
    joints = arm.board.joints()
    assert joints[1] == pytest.approx(500 + 0.5 * PULSES, abs=3)
    assert joints[4] == pytest.approx(500 - 0.3 * PULSES, abs=3)
    assert not arm.robot.arm.state.moving
    assert re.search(r"^base +\d+ +\+0\.5\d\d +6\d\d ", arm.command("arm")[1], re.MULTILINE)
    assert arm.json("arm")["joints"]["base"]["angle_rad"] == pytest.approx(0.5, abs=0.02)


def test_enable_takes_the_arm_to_its_drive_pose_first(arm: Simulated) -> None:
    said: list[str] = []
    arm.robot.enable(said.append)
    joints = arm.board.joints()
    assert [joints[servo] for servo in SERVOS[1:]] == pytest.approx(DRIVE[1:], abs=1)
    assert any("on its way" in text for text in said)
    arm.drive(0.3)
    assert arm.turning()
    with pytest.raises(arm.failstop.Refused, match="wheels enabled"):
        arm.robot.arm.move({"base": 0.1})


def test_without_an_arm_no_word_and_no_frame() -> None:
    plain = Simulated()
    plain.set_off()
    plain.drive(0.2)
    assert plain.robot.state.as_dict()["arm"] is None
    assert not [event for event in plain.board.events() if event.func == BUS_SERVO]
