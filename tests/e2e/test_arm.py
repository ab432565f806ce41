"""The arm through all processes, on the simulated machine and its board: the servos say where it is. Its rules are in
tests/procs."""

from __future__ import annotations

import re

import pytest

from failstop.board.framing import BUS_SERVO
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.simulated import Simulated

LEG_S = 0.06
"""The longest time of one frame of the stream."""
PULSES = 238.73
"""Pulses of a servo for a radian."""
SETTINGS = ARM


@pytest.fixture
def arm(simulated: Simulated) -> Simulated:
    return simulated


def follow(arm: Simulated, seconds: float, rate: float = -0.3) -> None:
    begun_ns = arm.now_ns()
    while (t := (arm.now_ns() - begun_ns) / 1e9) < seconds:
        arm.robot.arm.follow({"base": rate * t})
        arm.wait(0.02)


def test_move_goes_there_and_is_read_back(arm: Simulated) -> None:
    arm.robot.arm.move({"base": 0.5, "wrist": -0.3})
    joints = arm.board.joints()
    assert joints[1] == pytest.approx(500 + 0.5 * PULSES, abs=3)
    assert joints[4] == pytest.approx(500 - 0.3 * PULSES, abs=3)
    assert not arm.robot.arm.state.moving
    assert re.search(r"^base +\d+ +\+0\.5\d\d +6\d\d ", arm.command("arm")[1], re.MULTILINE)
    assert arm.json("arm")["joints"]["base"]["angle_rad"] == pytest.approx(0.5, abs=0.02)


def test_a_move_that_is_refused_as_too_fast_leaves_the_gate_alive_and_idle(arm: Simulated) -> None:
    before = arm.robot.state.processes["gate"]
    code, _, err = arm.command("arm", "move", "base=0.3", "--over", "0.05")
    assert code == 2
    assert re.search(r"refused: joint base at [56]\.\d+ rad/s between 0 and 0.05 s: allowed is up to 1\n", err)
    looks: list[int] = []
    arm.lab.machine.at_seam = lambda thread, call, about: looks.append(arm.now_ns())
    arm.wait(0.5)
    arm.lab.machine.at_seam = None
    assert len(looks) < 20_000, "nobody spins"
    after = arm.robot.state
    assert (after.processes["gate"].pid, after.cause) == (before.pid, None)
    assert all(joint.age_s < 1.0 for joint in after.arm.joints.values()), "it goes on to look at the servos"
    arm.robot.arm.move({"base": 0.1})


def test_follow_reaches_the_speed_and_a_stale_goal_holds_the_arm(arm: Simulated) -> None:
    follow(arm, 1.6)
    legs = [leg for leg in arm.board.joint_track() if leg.servo == 1 and leg.end_ns > leg.begin_ns]
    steady = legs[-16:-1]
    rate = (steady[-1].begin - steady[0].begin) / ((steady[-1].begin_ns - steady[0].begin_ns) * 1e-9)
    assert rate == pytest.approx(-0.3 * PULSES, rel=0.1)
    arm.wait_for("the arm to be held", lambda: arm.robot.arm.state.mode == "")
    stood = arm.board.joints()[1]
    arm.wait(0.1)
    assert arm.board.joints()[1] == stood


def test_hold_stops_it_at_once(arm: Simulated) -> None:
    follow(arm, 0.6)
    arm.robot.arm.hold()
    held = arm.board.joints()[1]
    arm.wait(0.1)
    stood = arm.board.joints()[1]
    assert stood == pytest.approx(held, abs=0.3 * 2 * LEG_S * PULSES), "what is under way and on the wire is ended"
    arm.wait(0.1)
    assert arm.board.joints()[1] == stood


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
