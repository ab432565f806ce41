"""The gate's arm: modes, limits, what holds it, and what must be true before motion is enabled."""

from __future__ import annotations

import statistics
from itertools import groupby, pairwise
from struct import unpack_from

import pytest

from failstop.messages import box, records
from failstop.policy import causes
from failstop.policy.joints import PULSES_PER_RAD
from tests.support.arm_settings import DRIVE, SERVOS
from tests.support.gate_scene import Scene
from tests.support.stage import MS

from .arm_moves import follow, moves_in, renew, sent

FOLLOW, JOG = records.ARM_FOLLOW, records.ARM_JOG


@pytest.fixture
def scene(arm_scene: Scene) -> Scene:
    return arm_scene


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
    scene.execute(dict.fromkeys(SERVOS, 0.3))
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
    scene.execute({1: 0.5})
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
    scene.execute({1: 0.5}, 2.0)
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
        scene.execute({1: 1.0})
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
    scene.execute({1: 0.1})
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
