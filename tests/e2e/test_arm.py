"""The arm through the real processes, on the simulated board: its servos say where it is."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from math import inf
from pathlib import Path

import pytest

from failstop import Refused, Robot
from failstop.board.framing import BUS_SERVO
from failstop.lab.trial import Trial, wait_for, write_settings
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.commands import failstop

LEG_S = 0.06
"""What one frame of the stream takes at most."""


@pytest.fixture
def arm(name: str, tmp_path: Path) -> Iterator[Trial]:
    path = tmp_path / "arm.toml"
    write_settings(str(path), ARM)
    with Trial(name, ("--config", str(path))) as running:
        yield running


def follow(arm: Trial, seconds: float, rate: float = -0.3) -> None:
    begun = time.monotonic()
    while (t := time.monotonic() - begun) < seconds:
        arm.robot.arm.follow({"base": rate * t})
        time.sleep(0.02)


def test_move_goes_there_and_is_read_back(arm: Trial) -> None:
    arm.robot.arm.move({"base": 0.5, "wrist": -0.3})
    joints = arm.board.joints()
    assert joints[1] == pytest.approx(500 + 0.5 * 238.73, abs=3)
    assert joints[4] == pytest.approx(500 - 0.3 * 238.73, abs=3)
    assert not arm.robot.arm.state.moving
    told = failstop("arm", "--name", arm.name).stdout
    assert re.search(r"^base +\d+ +\+0\.5\d\d +6\d\d ", told, re.MULTILINE)
    joints = json.loads(failstop("arm", "--json", "--name", arm.name).stdout)["joints"]
    assert joints["base"]["angle_rad"] == pytest.approx(0.5, abs=0.02)


def test_a_move_that_is_refused_as_too_fast_leaves_the_gate_alive_and_idle(arm: Trial) -> None:
    before = arm.robot.state.processes["gate"]
    found = failstop("arm", "move", "base=0.3", "--over", "0.05", "--name", arm.name)
    assert found.returncode == 2
    assert re.search(r"refused: joint base at [56]\.\d+ rad/s between 0 and 0.05 s: allowed is up to 1\n", found.stderr)
    since_s, ran_s = time.monotonic(), processor_s(before.pid)
    # It goes on to look at the servos, idly: a gate that spins is killed before that, or takes most of a core.
    wait_for("it to look at the arm again", lambda: looked_at_s(arm) > since_s + 0.5)
    assert processor_s(before.pid) - ran_s < (time.monotonic() - since_s) / 4
    after = arm.robot.state
    assert (after.processes["gate"].pid, after.cause) == (before.pid, None)
    arm.robot.arm.move({"base": 0.1})


def processor_s(pid: int | None) -> float:
    """The processor time that a process has had."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9


def looked_at_s(arm: Trial) -> float:
    """When the position of a joint was read last (time.monotonic)."""
    found = arm.robot.state.arm
    assert found
    return time.monotonic() - min(inf if joint.age_s is None else joint.age_s for joint in found.joints.values())


def test_follow_reaches_the_speed_and_a_stale_goal_holds_the_arm(arm: Trial) -> None:
    follow(arm, 1.6)
    legs = [leg for leg in arm.board.joint_track() if leg.servo == 1 and leg.end_ns > leg.begin_ns]
    steady = legs[-16:-1]
    rate = (steady[-1].begin - steady[0].begin) / ((steady[-1].begin_ns - steady[0].begin_ns) * 1e-9)
    assert rate == pytest.approx(-0.3 * 238.73, rel=0.1)
    wait_for("the arm to be held", lambda: arm.robot.arm.state.mode == "")
    stood = arm.board.joints()[1]
    time.sleep(0.1)
    assert arm.board.joints()[1] == stood


def test_hold_stops_it_at_once(arm: Trial) -> None:
    follow(arm, 0.6)
    arm.robot.arm.hold()
    held = arm.board.joints()[1]
    time.sleep(0.1)
    stood = arm.board.joints()[1]
    assert stood == pytest.approx(held, abs=0.3 * 2 * LEG_S * 238.73), "what is under way and on the wire is ended"
    time.sleep(0.1)
    assert arm.board.joints()[1] == stood


def test_no_frame_holds_the_receiver_and_none_is_a_long_move(arm: Trial) -> None:
    arm.robot.arm.pose("drive")
    moves = [event.data for event in arm.board.events() if event.func == BUS_SERVO and event.data[0] == 1]
    assert moves
    assert all(data[3] <= 2 and data[1] + 256 * data[2] <= LEG_S * 1000 for data in moves)


def test_enable_takes_the_arm_to_its_drive_pose_first(arm: Trial) -> None:
    said: list[str] = []
    arm.robot.enable(said.append)
    joints = arm.board.joints()
    assert [joints[servo] for servo in SERVOS[1:]] == pytest.approx(DRIVE[1:], abs=1)
    assert any("on its way" in text for text in said)
    arm.drive(0.3)
    assert arm.moving()
    with pytest.raises(Refused, match="wheels enabled"):
        arm.robot.arm.move({"base": 0.1})


def test_a_blocked_joint_refuses_motion_by_name(arm: Trial) -> None:
    arm.board.servo(3, blocked=True)
    with pytest.raises(Refused, match=r"arm is not in the drive pose: joint elbow \(servo 3\) is 4[45]\d pulses off"):
        arm.robot.enable()
    assert not arm.robot.state.enabled


def test_a_stop_on_the_way_to_the_drive_pose_wins(arm: Trial) -> None:
    def stop(_: str) -> None:
        arm.robot.estop("test")

    with pytest.raises(Refused, match="a stop is latched"):
        arm.robot.enable(stop)
    assert not arm.robot.state.enabled
    stood = arm.board.joints()
    time.sleep(0.1)
    assert arm.board.joints() == stood


def test_a_disable_gives_up_an_enable_of_another_task(arm: Trial) -> None:
    async def ask() -> None:
        async with Robot.connect(arm.name) as robot:
            enabling = asyncio.create_task(robot.enable())
            await robot.wait_for(lambda state: bool(state.arm and state.arm.moving), 5.0)
            assert await robot.disable() == "motion disabled"
            with pytest.raises(Refused):
                await enabling
            assert not robot.state.enabled

    asyncio.run(ask())


def test_a_disable_gives_up_an_enable_of_another_thread(arm: Trial) -> None:
    with Robot(arm.name) as robot, ThreadPoolExecutor(1) as threads:
        enabling = threads.submit(robot.enable)
        robot.wait_for(lambda state: bool(state.arm and state.arm.moving), 5.0)
        assert robot.disable() == "motion disabled"
        with pytest.raises(Refused):
            enabling.result()
        assert not robot.state.enabled


def test_a_second_publisher_latches(arm: Trial) -> None:
    follow(arm, 0.3)
    with Robot(arm.name, client="other") as other:
        other.arm.follow({"wrist": 0.1})
        wait_for("the latch", lambda: bool(arm.robot.state.estop))
    assert str(arm.robot.state.estop).startswith("multiple arm/goal publishers: ")


def test_without_an_arm_no_word_and_no_frame(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.2)
    assert trial.robot.state.as_dict()["arm"] is None
    assert not [event for event in trial.board.events() if event.func == BUS_SERVO]
