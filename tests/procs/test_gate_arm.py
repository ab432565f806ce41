"""The gate's arm: modes, limits, what holds it, and what must be true before motion is enabled."""

from __future__ import annotations

import statistics
from itertools import groupby, pairwise
from struct import unpack_from

import pytest

from failstop.messages import box, records
from failstop.policy import causes
from failstop.policy.joints import PULSES_PER_RAD
from tests.support.arm_settings import ARM, SERVOS
from tests.support.gate_scene import Scene
from tests.support.stage import MS

from .arm_moves import FOLLOW, JOG, follow, moves_in, renew, sent


@pytest.fixture
def scene(arm_scene: Scene) -> Scene:
    return arm_scene


@pytest.mark.parametrize("rate", [0.3, 0.04, -0.3])
def test_follow_keeps_the_speed_that_is_asked_for_however_slow(scene: Scene, rate: float) -> None:
    follow(scene, 3.0, rate)
    moves = sent(scene, 1)
    (t0, p0), (t1, p1) = moves[len(moves) // 2], moves[-1]
    pulses = rate * PULSES_PER_RAD * (t1 - t0) * 1e-9
    assert p1 - p0 == pytest.approx(pulses, abs=max(0.02 * abs(pulses), 1.0))


def test_the_stream_is_regular_and_each_move_short(scene: Scene) -> None:
    follow(scene, 2.0, 0.3)
    times = [t_ns for t_ns, _ in sent(scene, 1)]
    gaps = [after - before for before, after in pairwise(times)]
    assert statistics.median(gaps) == 40 * MS
    assert max(gaps) <= 45 * MS
    assert all(unpack_from("<H", data, 1)[0] <= 44 for _, data in scene.moves)


def test_all_six_joints_go_two_a_frame_and_none_is_dropped(scene: Scene) -> None:
    scene.travel(dict.fromkeys(SERVOS, 0.3))
    assert scene.finish() == (records.DONE, "arm is there")
    assert {data[3] for _, data in scene.moves} == {2}
    assert scene.dropped == 0
    for servo in SERVOS:
        assert scene.at(servo) == pytest.approx(500 + 0.3 * PULSES_PER_RAD, abs=3)


def test_what_it_is_to_do_is_in_the_black_box(scene: Scene) -> None:
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


def test_a_goal_that_is_not_renewed_holds_the_arm(scene: Scene) -> None:
    follow(scene, 0.5, 0.5)
    last_ns = scene.clock()
    scene.run(0.6)
    assert scene.moves[-1][0] - last_ns <= 500 * MS
    stood = scene.at(1)
    scene.run(0.5)
    assert scene.at(1) == stood
    assert scene.state()["mode"] == ""


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


@pytest.mark.parametrize(("values", "mode", "why"), BAD)
def test_a_goal_out_of_range_is_refused_by_name_and_latches_nothing(
    scene: Scene, values: dict[int, float], mode: int, why: str
) -> None:
    scene.goal(mode, values)
    scene.run(0.2)
    assert why in scene.state()["refused"]
    assert scene.moves == []
    assert scene.latched() is None


def test_a_trajectory_too_fast_or_out_of_range_is_refused(scene: Scene) -> None:
    scene.travel({1: 1.0}, 0.5)
    assert scene.finish()[1].startswith("joint base at 2.0")
    scene.travel({1: -3.0}, 0.5)
    assert scene.finish() == (records.REFUSED, "joint base to -3 rad: allowed is -2.094 to 2.094")
    assert scene.moves == []


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


def at_the_next_tick(scene: Scene) -> None:
    """Let the gate sleep until its next tick: what was asked meanwhile is handled in its very next turn."""
    scene.clock.now_ns += 20 * MS
    scene.gate.turn({})


@pytest.mark.parametrize("verb", [records.ARM_RELEASE, records.ARM_TUCK])
def test_what_is_asked_right_after_the_enable_is_refused(scene: Scene, verb: int) -> None:
    scene.ask_for(records.ENABLE)
    while scene.answered()[0] == records.UNDER_WAY:
        scene.wake()
    assert scene.answered() == (records.DONE, "motion enabled")
    scene.ask_for(verb)
    at_the_next_tick(scene)
    assert scene.answered() == (records.REFUSED, "wheels enabled")


@pytest.mark.parametrize("verb", [records.ARM_RELEASE, records.ARM_TUCK])
def test_what_is_asked_right_after_a_stop_is_refused(scene: Scene, verb: int) -> None:
    scene.stop(causes.PIPED(""))
    scene.ask_for(verb)
    at_the_next_tick(scene)
    done, text = scene.answered()
    assert done == records.REFUSED
    assert "a stop is latched" in text


def test_a_goal_right_after_a_stop_moves_nothing(scene: Scene) -> None:
    scene.stop(causes.PIPED(""))
    scene.goal(FOLLOW, {1: 0.3})
    at_the_next_tick(scene)
    assert scene.state()["mode"] == ""
    assert moves_in(scene, 1.0) == 0
    assert scene.state()["refused"] == scene.state()["closed"] == "a stop is latched"


def test_an_arm_that_is_left_alone_tucks_itself_and_announces_it() -> None:
    scene = Scene(ARM | {"arm.auto_tuck_s": 10.0})
    scene.run(30.0)
    assert scene.moves == [], "never used, never tucked"
    scene.travel({1: 0.5})
    assert scene.finish()[0] == records.DONE
    scene.run(6.0)
    assert scene.state()["tucks"]
    assert moves_in(scene, 3.0) == 0
    scene.run(8.0)
    assert scene.state()["pose"] == "tuck"
    assert moves_in(scene, 30.0) == 0


def test_a_released_arm_stays_limp_until_it_is_asked_to_move(scene: Scene) -> None:
    scene.travel({1: 0.2})
    assert scene.finish()[0] == records.DONE
    scene.ask_for(records.ARM_RELEASE)
    scene.run(0.2)
    assert all(servo.limp() for servo in scene.servos.by_id.values())
    scene.run(30.0)
    assert all(servo.limp() for servo in scene.servos.by_id.values())
    scene.travel({1: 0.1})
    assert scene.finish() == (records.DONE, "arm is there")


def test_the_gamepad_turns_a_joint_and_holds_it_when_let_go(scene: Scene) -> None:
    for _ in range(40):
        scene.pad(1, 0.5)
        scene.run(0.05)
    assert scene.state()["pad_joint"] == "shoulder"
    assert scene.at(2) > 560
    scene.pad(1, 0.0)
    scene.run(0.02)
    stood = scene.at(2)
    scene.run(0.3)
    assert scene.at(2) == pytest.approx(stood, abs=1)
    assert scene.state()["pad_joint"] is None


def test_the_gamepad_beside_a_program_latches(scene: Scene) -> None:
    follow(scene, 0.3, 0.3)
    scene.pad(1, 0.5)
    scene.run(0.02)
    assert scene.latched() == str(causes.TWO_MOVE_THE_ARM("test (pid 0)", "gamepad"))


def test_a_stream_that_a_stop_has_ended_does_not_begin_again_by_a_reset(scene: Scene) -> None:
    """Who holds a key through both has to let go of it first: a reset moves nothing."""
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


def test_who_holds_the_arm_ends_the_stream_of_another_until_that_pauses(scene: Scene) -> None:
    follow(scene, 1.0, 0.3)
    scene.ask_for(records.ARM_HOLD, client=1)
    follow(scene, 0.02, 0.3)
    stood = scene.at(1)
    follow(scene, 1.0, -0.3)
    assert scene.at(1) == pytest.approx(stood, abs=3)
    scene.run(0.6)
    follow(scene, 1.0, -0.3)
    assert scene.at(1) < stood - 10


def test_who_holds_the_arm_itself_may_go_on_at_once(scene: Scene) -> None:
    follow(scene, 1.0, 0.3)
    scene.ask_for(records.ARM_HOLD)
    stood = scene.at(1)
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


@pytest.mark.parametrize("verb", [records.ARM_DRIVE, records.ARM_TUCK, records.ARM_MOVE])
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


@pytest.mark.parametrize("verb", [records.ARM_DRIVE, records.ARM_TUCK])
@pytest.mark.parametrize("later", [records.ARM_HOLD, records.DISABLE, records.ARM_DRIVE, records.ARM_TUCK])
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
