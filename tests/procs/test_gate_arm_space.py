"""The gate looks where each of the arm's moves ends, whoever wants it, before it is sent: none hits anything."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from failstop.messages import records
from failstop.policy.capsules import FLOOR, Model
from failstop.policy.joints import PULSES_PER_RAD
from failstop.policy.settings import Settings
from tests.support.arm_settings import ARM, JOINTS, SERVOS
from tests.support.gate_scene import Scene

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
    made.execute({1: 1.5, 2: 1.5})
    assert made.finish() == (records.DONE, "arm is there")
    return made


def test_follow_ends_before_the_floor_and_goes_back_from_there(scene: Scene) -> None:
    assert watch(scene, 2.5, lambda: scene.goal(records.ARM_FOLLOW, {ELBOW: 1.5, 4: 0.2})) > -0.001
    assert gap_m(scene) < 0.02, "it went as far as it could"
    assert scene.state()["refused"] == f"the arm would hit something on its way: wrist and {FLOOR}"
    assert scene.latched() is None
    watch(scene, 2.5, lambda: scene.goal(records.ARM_FOLLOW, {ELBOW: 0.0, 4: 0.0}))
    assert scene.at(ELBOW) == pytest.approx(500, abs=2)
    assert scene.state()["refused"] == ""


def test_the_gamepad_s_joint_ends_before_the_floor(scene: Scene) -> None:
    assert watch(scene, 2.5, lambda: scene.pad(JOINTS.index("elbow"), 0.8)) > -0.001
    assert gap_m(scene) < 0.02
    assert FLOOR in scene.state()["refused"]


def test_a_trajectory_whose_client_did_not_look_is_held_and_refused(scene: Scene) -> None:
    scene.execute({ELBOW: 1.5})
    assert watch(scene, 2.5, lambda: None) > -0.001
    assert scene.answered() == (records.REFUSED, f"the arm would hit something on its way: wrist and {FLOOR}")
    assert not scene.state()["moving"]


def test_a_pose_and_the_way_to_enable_end_before_the_floor(scene: Scene) -> None:
    assert scene.result(records.ARM_TUCK)[1].startswith("the arm would hit something")
    done, text = scene.result(records.ENABLE)
    assert (done, text) == (
        records.REFUSED,
        f"arm is not in the drive pose: the arm would hit something on its way: wrist and {FLOOR}",
    )
    assert gap_m(scene) > -0.001
    assert not scene.gate.core.enabled


def test_an_arm_that_can_not_tuck_itself_says_so(scene: Scene) -> None:
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


def test_a_silent_servo_keeps_no_other_joint_from_moving(scene: Scene) -> None:
    scene.servos.change(10, scene.clock(), silent=True)
    scene.ask_for(records.ARM_READ)
    assert "gripper" in scene.finish()[1]
    scene.execute({ELBOW: 0.2})
    assert scene.finish() == (records.DONE, "arm is there")


def test_the_places_of_all_joints_are_read_before_one_of_them_moves(scene: Scene) -> None:
    """A shoulder that was moved by hand since: the elbow's way is another then."""
    scene.servos.change(2, scene.clock(), position=500)
    scene.gate.arm.core.forget()  # type: ignore[union-attr]
    scene.execute({ELBOW: 1.5})
    assert scene.finish() == (records.DONE, "arm is there")
