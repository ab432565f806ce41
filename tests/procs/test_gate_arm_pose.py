"""The gate's arm and the wheels: what must be true of it before motion is enabled."""

from __future__ import annotations

from random import Random

import pytest

from failstop.board.rrc.board import BOARD
from failstop.messages import records
from failstop.policy import causes
from tests.support.amounts import amount
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.gate_scene import Scene

from .arm_moves import follow, sent


@pytest.fixture
def scene(arm_scene: Scene) -> Scene:
    return arm_scene


FAULTS = [
    ({"blocked": True}, "joint shoulder (servo 2) is 29"),
    ({"silent": True}, "joint shoulder: no answer from servo 2"),
    ({"late": True}, "joint shoulder: no answer from servo 2"),
]


@pytest.mark.parametrize(("fault", "why"), FAULTS)
def test_a_fault_that_keeps_the_arm_from_its_pose_stops_an_enable(
    scene: Scene, fault: dict[str, object], why: str
) -> None:
    scene.servos.change(2, scene.clock(), **fault)
    done, text = scene.result(records.ENABLE)
    assert done == records.REFUSED
    assert text.startswith(f"arm is not in the drive pose: {why}")
    assert not scene.gate.core.enabled


@pytest.mark.parametrize("verb", [records.ARM_HOLD, records.DISABLE])
def test_an_enable_on_its_way_can_be_given_up(scene: Scene, verb: int) -> None:
    scene.ask_for(records.ENABLE)
    scene.run(0.6)
    scene.ask_for(verb, client=1)
    scene.run(0.1)
    assert scene.answered()[0] == records.REFUSED
    scene.run(3.0)
    assert not scene.gate.core.enabled


def test_a_stop_in_between_wins(scene: Scene) -> None:
    scene.ask_for(records.ENABLE)
    scene.run(0.6)
    scene.stop(causes.PIPED(""))
    scene.run(0.1)
    assert scene.answered() == (records.REFUSED, "a stop is latched (stop request)")
    scene.run(3.0)
    assert not scene.gate.core.enabled
    assert scene.result(records.ENABLE) == (records.REFUSED, "a stop is latched (stop request)")


@pytest.mark.parametrize(("setting", "done"), [("refuse", records.REFUSED), ("ignore", records.DONE)])
def test_an_absent_arm_refuses_once_clearly_and_can_be_ignored_by_a_setting(setting: str, done: int) -> None:
    scene = Scene(ARM | {"arm.absent": setting})
    for servo in SERVOS:
        scene.servos.change(servo, scene.clock(), silent=True)
    found, text = scene.result(records.ENABLE)
    assert found == done
    assert (setting == "ignore") or 'arm.absent = "ignore"' in text


@pytest.fixture
def no_pose() -> Scene:
    """The settings have no drive pose, so an enable asks nothing of the arm but to stand."""
    no_drive = {key: -1 for key in ARM if key.endswith(".drive")}
    made = Scene(ARM | no_drive | {"arm.drive_pan": -1, "interlocks.lid.timeout_s": 0.5})
    made.run(0.4)
    return made


def test_an_enable_right_behind_a_release_leaves_no_torque_on(no_pose: Scene) -> None:
    scene = no_pose
    scene.assert_lid()
    scene.ask_for(records.ARM_RELEASE)
    assert scene.result(records.ENABLE, client=1) == (
        records.REFUSED,
        "the arm is being released: ask again in a moment",
    )
    scene.run(0.1)
    assert all(servo.limp() for servo in scene.servos.by_id.values())
    assert scene.result(records.ENABLE, client=1) == (records.DONE, "motion enabled")
    scene.wake()
    assert scene.gate.loop.due_ns() > scene.clock()


def test_an_enable_takes_the_arm_from_who_moves_it_also_without_a_drive_pose(no_pose: Scene) -> None:
    """Nothing of it is left to go on with when an interlock disables motion again."""
    scene = no_pose
    scene.execute({1: 1.0}, over_s=6.0)
    scene.run(2.0)
    assert scene.state()["moving"]
    scene.assert_lid()
    assert scene.result(records.ENABLE, client=1) == (records.DONE, "motion enabled")
    stood = scene.at(1)
    assert scene.answered() == (records.REFUSED, "wheels enabled")
    assert not scene.state()["moving"]
    scene.run(2.0)
    assert not scene.gate.core.enabled
    assert scene.at(1) == stood


def test_a_joint_moved_by_hand_while_motion_was_enabled_is_read_before_it_moves(no_pose: Scene) -> None:
    scene = no_pose
    scene.assert_lid()
    scene.run(0.1)
    assert scene.result(records.ENABLE) == (records.DONE, "motion enabled")
    scene.servos.change(1, scene.clock(), position=300.0)
    scene.ask_for(records.DISABLE, client=1)
    scene.run(0.02)
    scene.execute({1: 0.5}, over_s=2.0)
    scene.run(1.0)
    assert sent(scene, 1)[0][1] == pytest.approx(300, abs=10)


def test_an_enable_goes_before_a_mere_way_to_the_pose_and_after_another_enable(scene: Scene) -> None:
    scene.ask_for(records.ARM_DRIVE)
    scene.run(0.1)
    scene.ask_for(records.ENABLE, client=1)
    scene.run(0.1)
    assert scene.answered() == (records.REFUSED, "wheels enabled")
    assert scene.result(records.ENABLE) == (records.REFUSED, "other (pid 0) is enabling motion")
    assert scene.finish(client=1) == (records.DONE, "motion enabled")


CASES = amount(8, 1000)


def test_no_motion_before_the_read_back_says_drive_pose() -> None:
    """Silent, blocked, late, hot, moved by hand, two clients, stops: whatever comes in between."""
    rng = Random(2)
    scene, wrong = Scene(ARM), []

    def judge(frame: bytes) -> None:
        for servo, drive in list(zip(SERVOS, DRIVE, strict=True))[1:5]:
            said = scene.said[servo]
            if frame != BOARD.stop and not (len(said) == 2 and all(abs(one - drive) <= 33 for one in said)):
                wrong.append((servo, said))

    scene.on_motion = judge
    enabled = refused = 0
    for _ in range(CASES):
        for servo in SERVOS:
            scene.servos.change(servo, scene.clock(), silent=False, blocked=False, unloaded=False, late=False)
            scene.servos.change(servo, scene.clock(), temperature_c=35)
            if rng.random() < 0.5:
                scene.servos.change(servo, scene.clock(), position=float(rng.randrange(1, 1000)))
            if rng.random() < 0.07:
                scene.servos.change(
                    servo, scene.clock(), **{rng.choice(("silent", "blocked", "unloaded", "late")): True}
                )
        if rng.random() < 0.2:
            scene.execute({1: rng.uniform(-1, 1)}, client=rng.randrange(2))
            scene.run(rng.random())
        scene.ask_for(records.ENABLE, rng.randrange(2))
        for _ in range(60):
            scene.run(0.05)
            what = rng.random()
            if what < 0.01:
                scene.servos.change(rng.choice(SERVOS), scene.clock(), position=float(rng.randrange(1, 1000)))
            elif what < 0.015:
                scene.stop(causes.PIPED(""))
            elif what < 0.02:
                scene.ask_for(rng.choice((records.ARM_HOLD, records.ENABLE, records.DISABLE)), rng.randrange(2))
            scene.command(0.1)
        enabled += scene.gate.core.enabled
        refused += not scene.gate.core.enabled
        scene.ask_for(records.DISABLE)
        scene.run(0.05)
        scene.ask_for(records.RESET)
        scene.run(0.3)
    assert wrong == []
    assert enabled
    assert refused


def test_the_gamepad_beside_a_program_latches(scene: Scene) -> None:
    follow(scene, 0.3, 0.3)
    scene.pad(1, 0.5)
    scene.run(0.02)
    assert scene.latched() == str(causes.TWO_MOVE_THE_ARM("test (pid 0)", "gamepad"))


def test_a_stream_that_a_stop_has_ended_does_not_begin_again_by_a_reset(scene: Scene) -> None:
    """A person who holds a key through both has to let go of it first: a reset moves nothing."""
    follow(scene, 1.0, 0.3)
    scene.stop(causes.PIPED(""))
    stood = scene.at(1)
    follow(scene, 0.3, -0.3)
    scene.ask_for(records.RESET, client=1)
    follow(scene, 1.0, -0.3)
    assert scene.answered(client=1)[0] == records.DONE
    assert scene.at(1) == pytest.approx(stood, abs=1)
    assert scene.state()["refused"] == "the goals before it were ended: pause first"
    scene.run(0.6)
    follow(scene, 1.0, -0.3)
    assert scene.at(1) < stood - 10


@pytest.mark.parametrize("client", [0, 1])
def test_a_hold_ends_the_stream_of_another_until_that_pauses_and_not_the_holder_s(scene: Scene, client: int) -> None:
    follow(scene, 1.0, 0.3)
    scene.ask_for(records.ARM_HOLD, client)
    if client == 1:
        follow(scene, 0.02, 0.3)
    stood = scene.at(1)
    follow(scene, 1.0, -0.3)
    if client == 1:
        assert scene.at(1) == pytest.approx(stood, abs=3)
        scene.run(0.6)
        follow(scene, 1.0, -0.3)
    assert scene.at(1) < stood - 10


def test_a_stick_held_through_a_stop_and_a_reset_turns_no_joint_until_let_go_of(
    scene: Scene,
) -> None:
    def hold(share: float) -> None:
        for _ in range(20):
            scene.pad(1, share)
            scene.run(0.05)

    hold(0.5)
    scene.stop(causes.PIPED(""))
    scene.ask_for(records.RESET)
    scene.run(0.06)
    assert scene.answered()[0] == records.DONE
    stood = scene.at(2)
    hold(0.5)
    assert scene.at(2) == stood
    scene.pad(1, 0.0)
    scene.run(0.02)
    hold(0.5)
    assert scene.at(2) > stood + 10


@pytest.mark.parametrize("verb", [records.ARM_DRIVE, records.ARM_MOVE])
def test_a_way_that_was_asked_for_before_a_stop_is_not_gone_after_it(scene: Scene, verb: int) -> None:
    """Its client was held up after it had dated the request."""
    asked_ns = scene.clock()
    scene.run(0.02)
    scene.stop(causes.PIPED(""))
    assert scene.result(records.RESET, client=1)[0] == records.DONE
    scene.ask_for(verb, asked_ns=asked_ns)
    assert "before the last stop" in scene.finish()[1]
    scene.run(1.0)
    assert not scene.moves


@pytest.mark.parametrize(
    ("verb", "later"),
    [
        (records.ARM_DRIVE, records.ARM_HOLD),
        (records.ARM_TUCK, records.DISABLE),
        (records.ARM_TUCK, records.ARM_DRIVE),
        (records.ARM_DRIVE, records.ARM_TUCK),
    ],
)
def test_a_way_that_was_asked_for_before_something_else_does_not_take_its_place(
    scene: Scene, verb: int, later: int
) -> None:
    """Its client looked at all of the way first, or its thread came late."""
    asked_ns = scene.clock()
    scene.run(0.02)
    assert scene.result(later)[0] == records.DONE
    moves = len(scene.moves)
    assert scene.result(verb, asked_ns=asked_ns) == (records.REFUSED, "a later request took its place: ask again")
    scene.run(0.5)
    assert len(scene.moves) == moves
