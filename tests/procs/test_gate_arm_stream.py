"""The stream of the arm's moves on the bench: which joints it waits for, holds and stops for what they would hit."""

from __future__ import annotations

import pytest

from failstop.board import servos
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.goals import Goal

from .arm_bench import ME, ArmBench

SHAPE = {"base__length_m": 0.05, "base__turns": "yaw", "shoulder__length_m": 0.3, "shoulder__turns": "pitch"}


def over_the_floor() -> ArmBench:
    """A long upper arm, and a chassis far above."""
    chassis = {"arm__chassis_z_m": 1.0, "arm__chassis_length_m": 0.0, "arm__chassis_radius_m": 0.0}
    changed: dict[str, object] = {f"joints__{key}": value for key, value in SHAPE.items()} | chassis
    return ArmBench(arm__collision="on", arm__mount_z_m=0.0, **changed)


def jog(bench: ArmBench, rates: dict[int, float]) -> None:
    joints = bench.core.joints
    goal = Goal(goals.JOG, ME, "client 11", bench.now, {joints[index]: rate for index, rate in rates.items()})
    bench.core.take(goal, "", bench.now)


def test_joint_that_would_hit_something_stays_where_it_is_and_a_journey_is_held() -> None:
    bench = over_the_floor().known()
    shoulder = bench.core.joints[1]
    trajectory = bench.execute((0.0, 950.0), joints=2)
    bench.until(lambda: trajectory.done)
    assert trajectory.outcome.startswith("the arm would hit something on its way: shoulder")
    assert bench.holds == [bench.now]
    assert bench.core.why_not() == ""
    stood = shoulder.position
    bench.known()
    for _ in range(10):
        jog(bench, {1: 1.0})
        bench.run(0.2)
    assert bench.core.why_not() == trajectory.outcome
    assert shoulder.velocity == 0.0
    assert shoulder.position == pytest.approx(stood, abs=10)


def test_joint_that_changes_no_touch_may_move() -> None:
    bench = over_the_floor()
    bench.servos.change(2, bench.now, position=980.0)
    bench.known()
    gripper = bench.core.joints[5]
    begin = gripper.position
    jog(bench, {5: 0.5})
    bench.run(0.4)
    assert bench.core.why_not() == ""
    assert gripper.position > begin + 10


def test_only_the_joints_that_move_are_waited_for_where_nothing_is_looked_at(arm_bench: ArmBench) -> None:
    arm_bench.core.forget()
    for servo in (3, 4):
        arm_bench.servos.change(servo, arm_bench.now, silent=True)
    arm_bench.goal()
    arm_bench.until(lambda: arm_bench.times(servos.SERVO_MOVE), most_s=0.1)
    assert [joint.name for joint in arm_bench.core.joints if joint.known] == ["base"]


def test_joint_that_a_newer_goal_leaves_out_comes_to_rest(arm_bench: ArmBench) -> None:
    jog(arm_bench, {0: 0.5, 1: 0.5})
    arm_bench.run(0.3)
    jog(arm_bench, {0: 0.5})
    arm_bench.run(0.3)
    stood = arm_bench.core.joints[1].position
    jog(arm_bench, {0: 0.5})
    arm_bench.run(0.3)
    assert arm_bench.core.streaming()
    assert arm_bench.core.joints[1].position == stood
