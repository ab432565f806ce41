"""The gate's arm and the wheels: what must be true of it before motion is enabled. And when the gate wakes for the arm:
later than now whatever was asked of it, taken or refused, and seldom."""

from __future__ import annotations

import re
from math import inf, nan
from random import Random

import pytest

from failstop.board.rrc.board import BOARD
from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.messages import records
from failstop.policy import causes
from failstop_lab.sim.servos import NOISE
from tests.support.amounts import amount
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.gate_scene import Scene
from tests.support.stage import MS

from .arm_moves import FOLLOW, JOG, follow, renew, sent


@pytest.mark.parametrize("fault", ["blocked", "silent", "late"])
def test_a_fault_that_keeps_the_arm_from_its_pose_stops_an_enable(scene: Scene, fault: str) -> None:
    scene.servos.change(2, scene.clock(), **{fault: True})
    done, text = scene.result(records.ENABLE)
    why = "joint shoulder (servo 2) is 29" if fault == "blocked" else "joint shoulder: no answer from servo 2"
    assert (done, text.startswith(f"arm is not in the drive pose: {why}")) == (records.REFUSED, True)
    assert not scene.gate.core.enabled


@pytest.mark.parametrize("verb", [records.ARM_HOLD, records.DISABLE, None])
def test_an_enable_on_its_way_can_be_given_up_and_a_stop_in_between_wins(scene: Scene, verb: int | None) -> None:
    scene.ask_for(records.ENABLE)
    scene.run(0.6)
    if verb is None:
        scene.stop(causes.PIPED(""))
    else:
        scene.ask_for(verb, client=1)
    scene.run(0.1)
    latched = (records.REFUSED, "a stop is latched (stop request)")
    assert scene.answered()[0] == records.REFUSED
    assert verb is not None or scene.answered() == latched
    scene.run(3.0)
    assert not scene.gate.core.enabled
    assert verb is not None or scene.result(records.ENABLE) == latched


@pytest.mark.parametrize(("setting", "done"), [("refuse", records.REFUSED), ("ignore", records.DONE)])
def test_an_absent_arm_refuses_clearly_and_can_be_ignored_by_a_setting(setting: str, done: int) -> None:
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
    refused = (records.REFUSED, "the arm is being released: ask again in a moment")
    assert scene.result(records.ENABLE, client=1) == refused
    scene.run(0.1)
    assert all(servo.limp() for servo in scene.servos.by_id.values())
    assert scene.result(records.ENABLE, client=1) == (records.DONE, "motion enabled")
    scene.wake()
    assert scene.gate.loop.due_ns() > scene.clock()


def test_an_enable_takes_the_arm_from_who_moves_it_also_without_a_drive_pose(no_pose: Scene) -> None:
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


def test_a_joint_that_sagged_while_its_servo_was_silent_is_read_before_a_held_key_moves_it(scene: Scene) -> None:
    """Its plug is loose, and makes contact again while somebody holds the key."""
    scene.execute({1: 0.5}, over_s=1.0)
    assert scene.finish() == (records.DONE, "arm is there")
    scene.servos.change(1, scene.clock(), silent=True, position=300.0)
    scene.run(10.0)
    assert scene.state()["silent"] == [1]
    before = len(sent(scene, 1))
    renew(scene, 10, JOG, {1: 0.3})
    scene.servos.change(1, scene.clock(), silent=False)
    renew(scene, 100, JOG, {1: 0.3})
    moves = [position for _, position in sent(scene, 1)[before:]]
    assert moves[0] == pytest.approx(300, abs=10)
    assert moves[-1] > 310


def test_an_enable_goes_before_a_mere_way_to_the_pose_and_after_another_enable(scene: Scene) -> None:
    scene.ask_for(records.ARM_DRIVE)
    scene.run(0.1)
    scene.ask_for(records.ENABLE, client=1)
    scene.run(0.1)
    assert scene.answered() == (records.REFUSED, "wheels enabled")
    assert scene.result(records.ENABLE) == (records.REFUSED, "other (pid 0) is enabling motion")
    assert scene.finish(client=1) == (records.DONE, "motion enabled")


CASES = amount(8, 1000)
FAULTS = ("silent", "blocked", "unloaded", "late")


def test_no_motion_before_the_read_back_says_drive_pose() -> None:
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
            scene.servos.change(servo, scene.clock(), **dict.fromkeys(FAULTS, False), temperature_c=35)
            if rng.random() < 0.5:
                scene.servos.change(servo, scene.clock(), position=float(rng.randrange(1, 1000)))
            if rng.random() < 0.07:
                scene.servos.change(servo, scene.clock(), **{rng.choice(FAULTS): True})
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


def test_a_stick_held_through_a_stop_and_a_reset_turns_no_joint_until_let_go_of(scene: Scene) -> None:
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


@pytest.mark.parametrize("client", [0, 1], ids=["of the one that enables", "of another"])
def test_an_enable_ends_a_stream_of_goals_that_goes_on(scene: Scene, client: int) -> None:
    """The stream must pause before it counts again, so it can't take the arm from its way to the drive pose."""
    follow(scene, 0.5, 0.3)
    scene.ask_for(records.ENABLE, client)
    follow(scene, 0.1, -0.3)
    assert scene.state()["refused"] == "the goals before it were ended: pause first"
    for _ in range(100):
        if scene.answered(client)[0] == records.UNDER_WAY:
            follow(scene, 0.1, -0.3)
    assert scene.answered(client) == (records.DONE, "motion enabled")


LATER = "a later request replaced it: ask again"
DATED = [
    *((verb, None, "before the last stop") for verb in (records.ARM_DRIVE, records.ARM_MOVE)),
    (records.ARM_DRIVE, records.ARM_HOLD, LATER),
    (records.ARM_TUCK, records.DISABLE, LATER),
    (records.ARM_TUCK, records.ARM_DRIVE, LATER),
    (records.ARM_DRIVE, records.ARM_TUCK, LATER),
]
"""A verb, and what comes between its date and its being heard; None: a stop and a reset."""


@pytest.mark.parametrize(("verb", "later", "told"), DATED)
def test_a_way_that_was_asked_for_before_something_else_does_not_take_its_place(
    scene: Scene, verb: int, later: int | None, told: str
) -> None:
    """Its client was held up after it had dated the request, or looked at all of the way first."""
    asked_ns = scene.clock()
    scene.run(0.02)
    if later is None:
        scene.stop(causes.PIPED(""))
    assert scene.result(records.RESET if later is None else later, client=int(later is None))[0] == records.DONE
    moves = len(scene.moves)
    done, text = scene.result(verb, asked_ns=asked_ns)
    assert (done, told in text) == (records.REFUSED, True)
    scene.run(0.5)
    assert len(scene.moves) == moves


VERBS = (records.ARM_DRIVE, records.ARM_TUCK, records.ARM_HOLD, records.ARM_RELEASE, records.ARM_READ)
ANGLES = (0.0, 0.01, 0.3, -0.3, 1.0, 3.0, 1e9, -1e300, inf, nan)
TIMES_S = (0.0, 0.001, 0.05, 0.5, 5.0, 599.0, 601.0, -1.0, nan)
GOALS = amount(400, 100_000)
MOST_TURNS = 300
"""In a second in which nobody asks for anything: ticks, the moves of six joints, questions and their answers."""


def rows(random: Random, servos: list[int]) -> list[tuple[float, list[float]]]:
    times = [random.choice(TIMES_S) for _ in range(random.choice((1, 1, 1, 2, 3)))]
    if random.random() < 0.7:
        times = sorted(times)
    return [(t_s, [random.choice(ANGLES[:6]) for _ in servos]) for t_s in times]


def ask(scene: Scene, random: Random) -> None:
    """Ask for something at random, as one of two clients, the gamepad, or whoever stops."""
    client = int(random.random() < 0.1)
    servos = random.sample(SERVOS, random.randint(1, len(SERVOS)))
    kind = random.random()
    if kind < 0.3:
        scene.go(random.choice((1.0, 0.2, 0.0, 7.0)), servos, rows(random, servos), client)
    elif kind < 0.75:
        scene.goal(random.choice((FOLLOW, JOG)), {servo: random.choice(ANGLES) for servo in servos}, client)
    elif kind < 0.9:
        scene.ask_for(random.choice(VERBS), client)
    elif kind < 0.93:
        scene.pad(random.randint(0, 6), random.choice((0.0, 1.0, -0.3)))
    elif kind < 0.96:
        scene.ask_for(random.choice((records.ENABLE, records.DISABLE)), client)
    else:
        scene.stop(causes.KEY(1))


@pytest.fixture(params=[{}, {"arm.collision": "off"}], ids=["minds what is in the way", "does not"])
def busy(request: pytest.FixtureRequest) -> Scene:
    made = Scene(ARM | request.param)
    made.run(0.4)
    return made


def turns_in_a_second(scene: Scene) -> int:
    """How often the gate wakes while nobody asks for anything."""
    began_ns, turns = scene.clock(), 0
    while scene.clock() - began_ns < 1000 * MS:
        scene.wake()
        assert scene.gate.loop.due_ns() > scene.clock()
        turns += 1
    return turns


@pytest.mark.timeout(3600)
def test_no_goal_leaves_a_timer_in_the_past(busy: Scene) -> None:
    random = Random(GOALS)
    taken = refused = 0
    for number in range(GOALS // 2):
        if busy.gate.core.latch and random.random() < 0.5:
            busy.stop(causes.KEY(1))  # the supervisor latches it too, so that a reset counts
            busy.ask_for(records.RESET)
        else:
            ask(busy, random)
        for _ in range(random.choice((1, 1, 2, 3, 5, 30))):
            busy.wake()
            assert busy.gate.loop.due_ns() > busy.clock(), number
        taken += busy.gate.arm is not None and bool(busy.gate.arm.core.followed)
        refused += bool(busy.state()["refused"])
        if not number % 50:
            assert turns_in_a_second(busy) < MOST_TURNS, number
    assert min(taken, refused) > GOALS / 50, "the goals are of both kinds"


def test_a_move_that_is_refused_as_too_fast_leaves_the_gate_asleep(busy: Scene) -> None:
    busy.execute({1: 0.3}, over_s=0.05)
    done, text = busy.finish()
    assert done == records.REFUSED
    found = re.match(r"joint base at (\S+) rad/s between 0 and 0\.05 s: ", text)
    assert found
    read_off = NOISE / PULSES_PER_RAD / 0.05
    assert float(found[1]) == pytest.approx(6.0, abs=read_off + 0.0005), "by where the joint was read"
    assert turns_in_a_second(busy) < 100
