"""The gate looks where each of the arm's moves ends, whoever wants it, before it is sent: none hits anything."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from failstop.board import servos
from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.messages import records
from failstop.policy.capsules import FLOOR, Model
from failstop.policy.settings import Settings
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.goals import Goal
from tests.support.arm_settings import ARM, JOINTS, SERVOS
from tests.support.gate_scene import Scene

from .arm_bench import ME, ArmBench

LINKS = (("yaw", 0.05), ("pitch", 0.15), ("pitch", 0.15), ("pitch", 0.1), ("roll", 0.0), ("none", 0.0))
LOW = round(500 + 1.5 * PULSES_PER_RAD)
SHAPE: dict[str, object] = {
    **ARM,
    **{f"joints.{name}.turns": turns for name, (turns, _) in zip(JOINTS, LINKS, strict=True)},
    **{f"joints.{name}.length_m": length_m for name, (_, length_m) in zip(JOINTS, LINKS, strict=True)},
    **{f"joints.{name}.radius_m": 0.02 for name in JOINTS},
    # Beside the robot, with the hand in the floor.
    **{f"joints.{name}.{pose}": LOW for name in JOINTS[:3] for pose in ("drive", "tuck")},
    **{f"joints.{name}.{pose}": 500 for name in JOINTS[3:] for pose in ("drive", "tuck")},
    "arm.mount_z_m": 0.2,
    "arm.collision": "on",
    "arm.auto_tuck_s": 20.0,
}
MODEL = Model(Settings(SHAPE))
ELBOW = 3


def gap_m(scene: Scene) -> float:
    """The gap by the model, from where the servos truly are."""
    angles = [(scene.at(servo) - 500) / PULSES_PER_RAD for servo in SERVOS]
    return MODEL.nearest(dict(zip(JOINTS, angles, strict=True)))[0]


def watch(scene: Scene, seconds: float, each: Callable[[], None]) -> float:
    """Let time pass; returns the smallest gap there was."""
    least_m = gap_m(scene)
    for _ in range(round(seconds / 0.02)):
        each()
        scene.run(0.02)
        least_m = min(least_m, gap_m(scene))
    return least_m


@pytest.fixture
def scene() -> Scene:
    """An arm with a shape, in mid-air beside its robot."""
    made = Scene(SHAPE)
    made.run(1.2)
    made.execute({1: 1.5, 2: 1.5, ELBOW: 0.0, 4: 0.0})
    assert made.finish() == (records.DONE, "arm is there")
    return made


@pytest.mark.parametrize("by", ["follow", "gamepad"])
def test_a_stream_ends_before_the_floor_and_goes_back_from_there(scene: Scene, by: str) -> None:
    def down() -> None:
        if by == "gamepad":
            scene.pad(JOINTS.index("elbow"), 0.8)
        else:
            scene.goal(records.ARM_FOLLOW, {ELBOW: 1.5, 4: 0.2})

    assert watch(scene, 2.5, down) > -0.001
    assert gap_m(scene) < 0.02, "it went as far as it could"
    assert scene.state()["refused"] == f"the arm would hit something on its way: wrist and {FLOOR}"
    assert scene.latched() is None
    if by == "follow":
        watch(scene, 2.5, lambda: scene.goal(records.ARM_FOLLOW, {ELBOW: 0.0, 4: 0.0}))
        assert scene.at(ELBOW) == pytest.approx(500, abs=2)
        assert scene.state()["refused"] == ""


def test_a_trajectory_whose_client_did_not_look_is_held_and_refused(scene: Scene) -> None:
    scene.execute({ELBOW: 1.5})
    assert watch(scene, 2.5, lambda: None) > -0.001
    assert scene.answered() == (records.REFUSED, f"the arm would hit something on its way: wrist and {FLOOR}")
    assert not scene.state()["moving"]


def test_a_pose_the_way_to_enable_and_an_arm_that_tucks_itself_end_before_the_floor(scene: Scene) -> None:
    hit = f"the arm would hit something on its way: wrist and {FLOOR}"
    assert scene.result(records.ARM_TUCK)[1] == hit
    assert scene.result(records.ENABLE) == (records.REFUSED, f"arm is not in the drive pose: {hit}")
    assert not scene.gate.core.enabled
    scene.run(26.0)
    assert any("the arm did not tuck itself: the arm would hit something" in text for text in scene.told())
    assert gap_m(scene) > -0.001


def test_links_that_touch_already_may_part(scene: Scene) -> None:
    """A hand moved it there, or the model is not exact: it must not be kept there."""
    scene.servos.change(ELBOW, scene.clock(), position=LOW)
    scene.result(records.ARM_READ)
    touching_m = gap_m(scene)
    assert touching_m < 0
    scene.execute({ELBOW: 2.0})
    assert scene.finish()[0] == records.REFUSED
    assert gap_m(scene) == pytest.approx(touching_m, abs=0.003)
    scene.execute({ELBOW: 0.0})
    assert scene.finish() == (records.DONE, "arm is there")


def test_the_places_of_all_joints_are_read_before_one_of_them_moves(scene: Scene) -> None:
    """A shoulder that was moved by hand since: the elbow's way is another then."""
    scene.servos.change(2, scene.clock(), position=500)
    scene.gate.arm.core.forget()
    scene.execute({ELBOW: 1.5})
    assert scene.finish() == (records.DONE, "arm is there")
    scene.servos.change(10, scene.clock(), silent=True)
    scene.ask_for(records.ARM_READ)
    assert "gripper" in scene.finish()[1]
    scene.execute({ELBOW: 0.2})
    assert scene.finish() == (records.DONE, "arm is there"), "a silent servo keeps no other from moving"


def test_a_journey_ends_if_a_hand_keeps_moving_a_joint_that_is_not_its_own(scene: Scene) -> None:
    """That joint has no torque, and where it is decides what the others may hit."""
    scene.result(records.ARM_RELEASE)
    scene.run(1.0)
    scene.execute({ELBOW: 0.5})
    for turn in range(1000):
        scene.servos.change(2, scene.clock(), position=300.0 + 17 * turn % 400)
        scene.run(0.005)
    assert scene.answered() == (records.REFUSED, "joint shoulder: where it is can't be read")
    assert not scene.state()["moving"]


LONG_ARM = {"base__length_m": 0.05, "base__turns": "yaw", "shoulder__length_m": 0.3, "shoulder__turns": "pitch"}


def over_the_floor() -> ArmBench:
    """A long upper arm, and a chassis far above."""
    chassis = {"arm__chassis_z_m": 1.0, "arm__chassis_length_m": 0.0, "arm__chassis_radius_m": 0.0}
    changed: dict[str, object] = {f"joints__{key}": value for key, value in LONG_ARM.items()} | chassis
    return ArmBench(arm__collision="on", arm__mount_z_m=0.0, **changed)


def jog(bench: ArmBench, rates: dict[int, float]) -> None:
    joints = bench.core.joints
    goal = Goal(goals.JOG, ME, "client 11", bench.now, {joints[index]: rate for index, rate in rates.items()})
    bench.core.accept(goal, "", bench.now)


def test_joint_that_would_hit_something_stays_where_it_is_and_a_journey_is_held() -> None:
    bench = over_the_floor().known()
    shoulder = bench.core.joints[1]
    trajectory = bench.execute((0.0, 950.0), joints=2)
    bench.until(lambda: trajectory.done)
    assert trajectory.outcome.startswith("the arm would hit something on its way: shoulder")
    assert bench.holds == [bench.now]
    assert bench.core.why_not(bench.now) == ""
    stood = shoulder.position
    bench.known()
    for _ in range(10):
        jog(bench, {1: 1.0})
        bench.run(0.2)
    assert bench.core.why_not(bench.now) == trajectory.outcome
    assert shoulder.velocity == 0.0
    assert shoulder.position == pytest.approx(stood, abs=10)
    gripper = bench.core.joints[5]
    begin = gripper.position
    jog(bench, {5: 0.5})
    bench.run(0.4)
    assert (bench.core.why_not(bench.now), gripper.position > begin + 10) == ("", True), (
        "a joint that changes no touch may move"
    )


def test_only_the_joints_that_move_are_waited_for_where_nothing_is_looked_at(bench: ArmBench) -> None:
    bench.core.forget()
    for servo in (3, 4):
        bench.servos.change(servo, bench.now, silent=True)
    bench.goal()
    bench.until(lambda: bench.times(servos.SERVO_MOVE), most_s=0.1)
    assert [joint.name for joint in bench.core.joints if joint.known] == ["base"]


def test_joint_that_a_newer_goal_leaves_out_comes_to_rest(bench: ArmBench) -> None:
    jog(bench, {0: 0.5, 1: 0.5})
    bench.run(0.3)
    jog(bench, {0: 0.5})
    bench.run(0.3)
    stood = bench.core.joints[1].position
    jog(bench, {0: 0.5})
    bench.run(0.3)
    assert bench.core.streaming()
    assert bench.core.joints[1].position == stood
