"""The gate's arm: modes, limits, what holds it, and what must be true before motion is enabled."""

from __future__ import annotations

import statistics
from itertools import groupby, pairwise
from random import Random
from struct import unpack_from

import pytest

from failstop.board.interface import BOARD
from failstop.messages import box, records
from failstop.policy import causes
from failstop.policy.joints import PULSES_PER_RAD
from tests.support.amounts import amount
from tests.support.arm_settings import ARM, DRIVE, SERVOS
from tests.support.gate_scene import Scene
from tests.support.stage import MS

FOLLOW, JOG = records.ARM_FOLLOW, records.ARM_JOG


@pytest.fixture
def scene(arm_scene: Scene) -> Scene:
    return arm_scene


def follow(scene: Scene, seconds: float, rate: float, servo: int = 1) -> None:
    begun_ns = scene.clock()
    while (t_s := (scene.clock() - begun_ns) * 1e-9) < seconds:
        scene.goal(FOLLOW, {servo: rate * t_s})
        scene.run(0.02)


def renew(scene: Scene, times: int, mode: int, values: dict[int, float]) -> None:
    """One goal again and again."""
    for _ in range(times):
        scene.goal(mode, values)
        scene.run(0.02)


def moves_in(scene: Scene, seconds: float) -> int:
    """How many moves are sent in that time."""
    before = len(scene.moves)
    scene.run(seconds)
    return len(scene.moves) - before


def sent(scene: Scene, servo: int) -> list[tuple[int, int]]:
    """(when, where to) of each move of a servo."""
    found = []
    for t_ns, data in scene.moves:
        for index in range(data[3]):
            to, position = unpack_from("<BH", data, 4 + 3 * index)
            found += [(t_ns, position)] if to == servo else []
    return found


@pytest.mark.parametrize("rate", [0.04, -0.3])
def test_follow_keeps_the_speed_that_is_asked_for_in_a_regular_stream(scene: Scene, rate: float) -> None:
    follow(scene, 3.0, rate)
    moves = sent(scene, 1)
    (t0, p0), (t1, p1) = moves[len(moves) // 2], moves[-1]
    pulses = rate * PULSES_PER_RAD * (t1 - t0) * 1e-9
    assert p1 - p0 == pytest.approx(pulses, abs=max(0.02 * abs(pulses), 1.0))
    gaps = [after - before for (before, _), (after, _) in pairwise(moves)]
    assert statistics.median(gaps) == 40 * MS
    assert max(gaps) <= 45 * MS
    assert all(unpack_from("<H", data, 1)[0] <= 44 for _, data in scene.moves), "each move is short"


def test_all_six_joints_go_two_a_frame_and_none_is_dropped(scene: Scene) -> None:
    scene.travel(dict.fromkeys(SERVOS, 0.3))
    assert scene.finish() == (records.DONE, "arm is there")
    assert {data[3] for _, data in scene.moves} == {2}
    assert scene.dropped == 0
    for servo in SERVOS:
        assert scene.at(servo) == pytest.approx(500 + 0.3 * PULSES_PER_RAD, abs=3)


def test_the_black_box_has_what_the_arm_is_to_do(scene: Scene) -> None:
    ring = scene.own.ring_reader("arm_box")
    follow(scene, 1.0, 0.3)
    scene.run(0.1)
    scene.goal(JOG, {1: 0.1, 2: -0.1})
    scene.run(0.6)
    scene.travel({1: 0.5})
    scene.run(0.3)
    kept = []
    while entry := ring.next():
        kept.append((entry[1], *box.unpack_arm(entry[2])))
    assert [mode for mode, _ in groupby(kept, lambda one: one[1])] == ["follow", "jog", "", "trajectory"]
    assert {who for _, mode, who, _ in kept if mode} == {"test (pid 0)"}
    assert next(aims for _, mode, _, aims in reversed(kept) if mode == "follow")[1] == pytest.approx(
        500 + 0.3 * PULSES_PER_RAD, abs=3
    )
    assert kept[-1][3] == {1: pytest.approx(500 + 0.5 * PULSES_PER_RAD, abs=0.1)}
    gaps = [after[0] - before[0] for before, after in pairwise(kept) if before[1] == after[1] == "follow"]
    assert len(gaps) > 8
    assert min(gaps) >= 100 * MS


def test_no_joint_passes_its_speed_or_its_ramp(scene: Scene) -> None:
    scene.goal(FOLLOW, {1: 2.0})
    renew(scene, 60, FOLLOW, {1: 2.0})
    moves = sent(scene, 1)
    speeds = [(p1 - p0) / 0.04 / PULSES_PER_RAD for (_, p0), (_, p1) in pairwise(moves)]
    assert max(speeds) <= 1.0 + 1 / 0.04 / PULSES_PER_RAD
    ramps = [abs(after - before) / 0.04 for before, after in pairwise(speeds)]
    assert max(ramps) <= 4.0 + 2 / 0.04**2 / PULSES_PER_RAD


def test_jog_stops_at_the_soft_limit(scene: Scene) -> None:
    renew(scene, 300, JOG, {1: 1.0})
    assert scene.at(1) == 1000
    assert max(position for _, position in sent(scene, 1)) == 1000


def test_a_trajectory_goes_before_a_stream_and_the_newest_goal_before_older_ones(scene: Scene) -> None:
    scene.travel({1: 0.5}, 2.0)
    renew(scene, 40, FOLLOW, {1: -0.5})
    assert scene.state()["mode"] == "trajectory"
    assert scene.at(1) > 510
    renew(scene, 100, FOLLOW, {1: 0.6})
    assert scene.state()["mode"] == "follow"
    assert scene.at(1) == pytest.approx(500 + 0.6 * PULSES_PER_RAD, abs=8)
    scene.goal(JOG, {1: -0.5})
    scene.run(0.3)
    assert scene.state()["mode"] == "jog"
    assert scene.at(1) < 500 + 0.55 * PULSES_PER_RAD, "at once, and not when the last angle has run out"


BAD = [
    ({1: float("nan")}, FOLLOW, "joint base to nan rad"),
    ({1: float("inf")}, FOLLOW, "joint base to inf rad"),
    ({1: 2.2}, FOLLOW, "joint base to 2.2 rad: allowed is -2.094 to 2.094"),
    ({1: 1.1}, JOG, "joint base at 1.1 rad/s: allowed is up to 1"),
    ({1: float("nan")}, JOG, "joint base at nan rad/s"),
    ({7: 0.1}, FOLLOW, "for joints that the arm does not have"),
]


def test_a_goal_out_of_range_is_refused_by_name_and_latches_nothing(scene: Scene) -> None:
    for values, mode, why in BAD:
        scene.goal(mode, values)
        scene.run(0.02)
        assert why in scene.state()["refused"]
    assert scene.moves == []
    assert scene.latched() is None


@pytest.mark.parametrize("mode", ["follow", "trajectory"])
def test_a_second_publisher_latches_and_the_arm_is_held(scene: Scene, mode: str) -> None:
    if mode == "follow":
        follow(scene, 0.3, 0.5)
    else:
        scene.travel({1: 1.0})
        scene.run(0.6)
    scene.goal(FOLLOW, {2: 0.1}, client=1)
    scene.run(0.02)
    assert str(scene.latched()).startswith("multiple arm/goal publishers: test")
    assert moves_in(scene, 0.3) == 0


def test_a_client_that_goes_has_its_arm_held(scene: Scene) -> None:
    follow(scene, 0.5, 0.5)
    scene.clients[0].segment.wipe()
    scene.run(0.02)
    stood = scene.at(1)
    assert moves_in(scene, 0.3) == 0
    assert scene.at(1) == pytest.approx(stood, abs=1)


def test_an_enable_goes_to_the_pose_and_says_how_far_it_is(scene: Scene) -> None:
    scene.ask_for(records.ENABLE)
    scene.run(0.3)
    assert scene.answered()[0] == records.UNDER_WAY
    assert scene.finish() == (records.DONE, "motion enabled")
    assert [scene.at(servo) for servo in SERVOS[1:]] == pytest.approx(DRIVE[1:], abs=2)
    questions = scene.said.copy()
    scene.run(1.0)
    assert scene.said == questions, "no reads while motion is enabled"
    scene.travel({1: 0.1})
    assert scene.finish() == (records.REFUSED, "wheels enabled")
    assert scene.result(records.DISABLE)[0] == records.DONE


def at_the_next_tick(scene: Scene) -> None:
    """Let the gate sleep until its next tick: what was asked meanwhile is handled in its very next turn."""
    scene.clock.now_ns += 20 * MS
    scene.gate.turn({})


def test_a_request_right_after_the_enable_is_refused(scene: Scene) -> None:
    scene.ask_for(records.ENABLE)
    while scene.answered()[0] == records.UNDER_WAY:
        scene.wake()
    assert scene.answered() == (records.DONE, "motion enabled")
    scene.ask_for(records.ARM_RELEASE)
    scene.ask_for(records.ARM_TUCK, client=1)
    at_the_next_tick(scene)
    assert [scene.answered(client) for client in (0, 1)] == [(records.REFUSED, "wheels enabled")] * 2


def test_a_request_right_after_a_stop_is_refused_and_moves_nothing(scene: Scene) -> None:
    scene.stop(causes.PIPED(""))
    scene.ask_for(records.ARM_RELEASE)
    scene.ask_for(records.ARM_TUCK, client=1)
    scene.goal(FOLLOW, {1: 0.3})
    at_the_next_tick(scene)
    for client in (0, 1):
        done, text = scene.answered(client)
        assert done == records.REFUSED
        assert "a stop is latched" in text
    assert scene.state()["mode"] == ""
    assert moves_in(scene, 1.0) == 0
    assert scene.state()["refused"] == scene.state()["closed"] == "a stop is latched"


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
    scene.travel({1: 1.0}, over_s=6.0)
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
    scene.travel({1: 0.5}, over_s=2.0)
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
            scene.travel({1: rng.uniform(-1, 1)}, client=rng.randrange(2))
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
