"""The gate's arm: modes, limits, what holds it, and what must be true before motion is enabled."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from itertools import groupby, pairwise
from struct import unpack_from
from typing import Any

import pytest

from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.messages import box, records
from failstop.messages.packing import Note
from failstop.policy import causes
from tests.support.arm_settings import DRIVE, JOINTS, SERVOS, TUCK
from tests.support.gate_scene import Scene
from tests.support.stage import MS

from .arm_bench import Make
from .arm_moves import follow, moves_in, renew, sent

FOLLOW, JOG = records.ARM_FOLLOW, records.ARM_JOG


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


NONE = "for joints that the arm does not have"
BAD = [
    ({1: float("nan")}, FOLLOW, "joint base to nan rad"),
    ({1: float("inf")}, FOLLOW, "joint base to inf rad"),
    ({1: 2.2}, FOLLOW, "joint base to 2.2 rad: allowed is -2.094 to 2.094"),
    ({1: 1.1}, JOG, "joint base at 1.1 rad/s: allowed is up to 1"),
    ({1: float("nan")}, JOG, "joint base at nan rad/s"),
    *(({servo: 0.1}, mode, f"a goal of test (pid 0) {NONE}") for servo, mode in ((7, FOLLOW), (1, 9))),
]


def test_a_goal_out_of_range_is_refused_by_name_and_latches_nothing(scene: Scene) -> None:
    for values, mode, why in BAD:
        scene.goal(mode, values)
        scene.run(0.02)
        assert why in scene.state()["refused"]
    assert scene.moves == []
    assert scene.latched() is None
    scene.goal(FOLLOW, dict.fromkeys(SERVOS, 0.0))
    scene.run(0.02)
    assert scene.state()["refused"] == "", "a goal may name every joint"


@pytest.mark.parametrize("first", ["follow", "trajectory"])
@pytest.mark.parametrize("second", ["a program", "a program's way", "gamepad"])
def test_who_moves_it_beside_another_latches_and_the_arm_is_held(scene: Scene, first: str, second: str) -> None:
    if first == "follow":
        follow(scene, 0.3, 0.5)
    else:
        scene.execute({1: 1.0})
        scene.run(0.6)
    if second == "gamepad":
        scene.pad(1, 0.5)
    elif second == "a program":
        scene.goal(FOLLOW, {2: 0.1}, client=1)
    else:
        scene.execute({1: 0.2}, client=1)
        assert scene.finish(client=1)[1].startswith("a stop is latched")
    scene.run(0.02)
    rival = "gamepad" if second == "gamepad" else "other (pid 0)"
    assert scene.latched() == str(causes.TWO_MOVE_THE_ARM("test (pid 0)", rival))
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
    assert scene.told() == ["motion enabled by test"]
    assert [scene.at(servo) for servo in SERVOS[1:]] == pytest.approx(DRIVE[1:], abs=2)
    questions = scene.said.copy()
    scene.run(1.0)
    assert scene.said == questions, "no reads while motion is enabled"
    scene.execute({1: 0.1})
    assert scene.finish() == (records.REFUSED, "wheels enabled")
    assert scene.result(records.DISABLE)[0] == records.DONE


def test_a_request_right_after_the_enable_or_a_stop_is_refused_and_moves_nothing(scene: Scene) -> None:
    def ask_for_both() -> list[tuple[int, str]]:
        """In the very next turn: the gate slept until its next tick meanwhile."""
        scene.ask_for(records.ARM_RELEASE)
        scene.ask_for(records.ARM_TUCK, client=1)
        scene.clock.now_ns += 20 * MS
        scene.gate.turn({})
        return [scene.answered(client) for client in (0, 1)]

    scene.ask_for(records.ENABLE)
    while scene.answered()[0] == records.UNDER_WAY:
        scene.wake()
    assert scene.answered() == (records.DONE, "motion enabled")
    assert ask_for_both() == [(records.REFUSED, "wheels enabled")] * 2
    scene.stop(causes.PIPED(""))
    scene.goal(FOLLOW, {1: 0.3})
    for done, text in ask_for_both():
        assert (done, "a stop is latched" in text) == (records.REFUSED, True)
    moved = scene.state()["mode"], moves_in(scene, 1.0)
    assert moved == ("", 0)
    assert scene.state()["refused"] == scene.state()["closed"] == "a stop is latched"


def notes(scene: Scene) -> Callable[[], list[tuple[str, str]]]:
    """(level, text) of what people are told of the arm from now on, since the last call."""
    ring = scene.own.ring_reader("notes")

    def news() -> list[tuple[str, str]]:
        found = [Note.unpack(entry[2]) for entry in iter(ring.next, None)]
        return [(note.level, note.text) for note in found if note.kind == "arm"]

    return news


FAULTS: dict[int, dict[str, Any]] = {2: {"silent": True}, 3: {"temperature_c": 70}, 4: {"supply_mv": 5999}}
TOLD = {
    "shoulder (servo 2)": "does not answer",
    "elbow (servo 3)": "is hot: 70 degrees or more; at 85 it lets go",
    "wrist (servo 4)": "has less than 6000 mV; with little less it lets go",
}


def test_faults_of_servos_are_told_once_and_their_end(scene: Scene) -> None:
    news = notes(scene)
    scene.run(10.0)
    assert news() == []
    for servo, fault in FAULTS.items():
        scene.servos.change(servo, scene.clock(), **fault)
    scene.run(10.0)
    assert sorted(news()) == sorted(("warning", f"joint {of} {text}") for of, text in TOLD.items())
    assert sorted(scene.state()["wrong"]) == sorted(f"joint {of.partition(' ')[0]} {text}" for of, text in TOLD.items())
    assert scene.state()["silent"] == [2]
    for servo in FAULTS:
        scene.servos.change(servo, scene.clock(), silent=False, temperature_c=69, supply_mv=6000)
    scene.run(10.0)
    assert sorted(news()) == sorted(("", f"joint {of} is fine again") for of in TOLD)
    assert scene.state()["wrong"] == []


def test_arm_that_is_left_alone_says_so_and_tucks_itself_on_time(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=5.0, arm__tuck_notice_s=2.0)
    news = notes(scene)
    scene.run(6.0)
    assert scene.moves == [], "never used, never tucked"
    assert scene.state()["auto_tuck_s"] is None
    scene.execute({1: 0.5})
    scene.finish()
    assert scene.state()["auto_tuck_s"] == 5
    assert not scene.state()["tucks"]
    alone_ns = scene.clock()
    scene.run(2.9)
    assert news() == []
    scene.run(0.2)
    assert news() == [("", "nobody uses the arm, so it goes to its tuck pose in 2 s")]
    assert scene.state()["tucks"]
    assert scene.state()["auto_tuck_s"] == 2
    count = len(scene.moves)
    scene.run(3.0)
    assert scene.state()["by"] == "auto-tuck"
    assert scene.state()["auto_tuck_s"] is None
    assert not scene.state()["tucks"]
    began_s = (scene.moves[count][0] - alone_ns) * 1e-9
    assert 4.9 < began_s < 5.3
    scene.run(10.0)
    assert [scene.at(servo) for servo in SERVOS] == pytest.approx(TUCK, abs=2)
    assert scene.state()["pose"] == "tuck"
    scene.run(7.0)
    assert news() == []


def test_arm_that_is_used_again_before_it_tucks_is_announced_anew(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=10.0)
    news = notes(scene)
    scene.execute({1: 0.5})
    scene.finish()
    scene.run(7.0)
    assert len(news()) == 1
    scene.execute({1: 0.4})
    scene.finish()
    scene.run(4.5)
    assert news() == []
    scene.run(1.5)
    assert len(news()) == 1
    scene.ask_for(records.ENABLE)
    assert scene.finish()[0] == records.DONE
    scene.run(12.0)
    assert news() == [], "wheels enabled: it must not"
    assert scene.state()["auto_tuck_s"] in (None, 10)
    scene.ask_for(records.DISABLE)
    scene.run(9.0)
    assert len(news()) == 1
    scene.run(6.0)
    assert scene.state()["pose"] == "tuck" or scene.state()["by"] == "auto-tuck"


def test_people_are_told_nothing_of_servos_that_are_well(scene: Scene) -> None:
    scene.execute({1: 0.2})
    assert scene.finish() == (records.DONE, "arm is there")
    scene.run(2.0)
    assert scene.state()["wrong"] == []
    ring = scene.own.ring_reader("notes", from_oldest=True)
    assert [note.text for entry in iter(ring.next, None) if (note := Note.unpack(entry[2])).kind == "arm"] == []


def test_arm_that_the_gamepad_moved_last_tucks_itself(arm_with: Make) -> None:
    """The gamepad's word counts once, as a share of the speed that the joint may have."""
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5, joints__base__speed_radps=0.5)
    scene.pad(0, 0.5)
    scene.run(0.1)
    assert (scene.state()["mode"], scene.state()["refused"]) == ("jog", "")
    scene.run(3.0)
    assert scene.state()["by"] == "auto-tuck"


def test_released_arm_stays_limp_until_it_is_asked_to_move(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=1.0, arm__tuck_notice_s=0.5)
    scene.execute({1: 0.2})
    scene.finish()
    scene.ask_for(records.ARM_RELEASE)
    for seconds in (0.2, 10.0):
        scene.run(seconds)
        assert all(servo.limp() for servo in scene.servos.by_id.values())
    scene.execute({1: 0.1})
    assert scene.finish() == (records.DONE, "arm is there")


def test_reading_a_released_arm_does_not_make_it_tuck_itself(arm_with: Make) -> None:
    """Somebody may hold it; LeRobot reads an arm without torque when it connects."""
    scene = arm_with(arm__auto_tuck_s=1.0, arm__tuck_notice_s=0.5)
    scene.execute({1: 0.2})
    scene.finish()
    scene.ask_for(records.ARM_RELEASE)
    scene.run(0.2)
    scene.ask_for(records.ARM_READ)
    assert scene.finish()[0] == records.DONE
    scene.run(10.0)
    assert all(servo.limp() for servo in scene.servos.by_id.values())


@pytest.mark.parametrize("how", ["fails", "is ended", "is off", "is there already"])
def test_tuck_of_an_arm_left_alone_is_told_of_where_it_fails(arm_with: Make, how: str) -> None:
    off: dict[str, object] = {"arm__auto_tuck": "off"} if how == "is off" else {}
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5, **off)
    news = notes(scene)
    if how == "is there already":
        scene.ask_for(records.ARM_TUCK)
    else:
        scene.execute({1: 0.5})
    assert scene.finish(most_s=20.0) == (records.DONE, "arm is there")
    if how == "fails":
        scene.servos.change(2, scene.clock(), blocked=True)
    scene.run(3.0)
    assert (scene.state()["by"] == "auto-tuck") is (how in ("fails", "is ended"))
    if how == "is ended":
        scene.ask_for(records.ARM_HOLD)
    scene.run(12.0 if how != "is ended" else 0.2)
    told = news()
    assert [level for level, _ in told[:2]] == {"fails": ["", "warning"], "is ended": [""]}.get(how, [])
    assert how != "fails" or told[1][1].startswith("the arm did not tuck itself: joint shoulder (servo 2) is 46")
    assert how != "is off" or scene.at(1) > 600
    assert not scene.state()["tucks"], "nothing is announced any more"


def test_tuck_that_can_not_begin_is_not_tried_again(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5)
    scene.execute({1: 0.5})
    scene.finish()
    for servo in SERVOS:
        scene.servos.change(servo, scene.clock(), silent=True)
    news = notes(scene)
    scene.run(12.0)
    assert any("did not tuck itself" in text for _, text in news())
    scene.run(8.0)
    assert news() == []


def test_an_arm_of_which_one_joint_has_a_tuck_pose_at_0_tucks_itself(arm_with: Make) -> None:
    others = {f"joints__{name}__tuck": -1 for name in JOINTS}
    scene = arm_with(arm__auto_tuck_s=5.0, **{**others, "joints__base__tuck": 0})
    scene.execute({1: 0.5})
    scene.finish()
    assert scene.state()["auto_tuck_s"] == 5


def test_an_arm_without_a_tuck_pose_is_not_said_to_tuck_itself(arm_with: Make) -> None:
    without = {f"joints__{name}__tuck": -1 for name in JOINTS}
    scene = arm_with(arm__auto_tuck_s=5.0, arm__tuck_notice_s=2.0, **without)
    news = notes(scene)
    scene.execute({1: 0.5})
    scene.finish()
    scene.run(6.0)
    assert scene.state()["auto_tuck_s"] is None
    assert not scene.state()["tucks"]
    assert news() == []
