"""The arm's decisions: the core alone with its servos, on a clock that the test moves from one due time to the next."""

from __future__ import annotations

from collections.abc import Callable
from struct import iter_unpack

import pytest

from failstop.board import servos
from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.board.servos import LONGEST_MOVE_MS, MOST_MOVES
from failstop.policy.joints import MOST_MISSES
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.core import ENDED, FIND_NS, LIMP_NS, LOST_NS, SERVICE, TORQUE_APART_NS
from failstop.procs.gate.arm.goals import Goal
from failstop.procs.gate.arm.reader import APART_NS, QUIET_NS
from failstop.procs.gate.arm.stream import MOVES_APART_NS
from tests.support.arm_settings import SERVOS

from .arm_bench import ME, OTHER, SERVO_ANSWER_NS, ArmBench
from .gate_bench import MS, T0, TICK

PERIOD_NS = 40 * MS
TIMEOUT_NS = 500 * MS


def test_release_switches_one_torque_after_the_other_off_until_the_arm_is_used_again(bench: ArmBench) -> None:
    bench.execute((0.0, 510.0), joints=6)
    bench.run(2.0)
    assert all(joint.loaded for joint in bench.core.joints)
    bench.frames.clear()
    bench.core.release(bench.now)
    begun_ns = bench.now
    assert [joint.state()[5] for joint in bench.core.joints] == [False] * 6
    assert (bench.core.active_ns, bench.core.released) == (0, True)
    for _ in range(6):
        bench.look()
        due_ns = bench.core.due_ns
        for bench.now in (due_ns - 1, due_ns):
            bench.look()
    assert bench.frames == [
        (begun_ns + number * TORQUE_APART_NS, bytes((servos.TORQUE_OFF, servo)))
        for number, servo in enumerate(SERVOS, 1)
    ]
    assert bench.holds == [], "its caller has written the stop"
    bench.now += SERVO_ANSWER_NS
    bench.goal()
    assert (bench.core.active_ns, bench.core.released) == (bench.now, False)
    bench.core.release(bench.now)
    bench.execute((0.0, 500.0))
    assert (bench.core.active_ns, bench.core.released) == (bench.now, False)
    bench.until(lambda: bench.times(servos.TORQUE_ON))


def test_torques_are_switched_on_one_after_the_other_before_the_first_move(bench: ArmBench) -> None:
    bench.until(lambda: bench.core.due_ns > bench.now + 50 * MS)
    bench.frames.clear()
    asked_ns = bench.now
    bench.execute((0.0, 600.0), joints=6)
    bench.look()
    bench.until(lambda: bench.times(servos.TORQUE_ON))
    assert bench.core.due_ns == bench.now + TORQUE_APART_NS, "it sleeps until the next may be sent"
    bench.until(lambda: len(bench.times(servos.SERVO_MOVE)) > 3)
    on = bench.times(servos.TORQUE_ON)
    assert on == [on[0] + number * TORQUE_APART_NS for number in range(6)]
    read = [t_ns for t_ns in bench.times(servos.POSITION) if t_ns >= asked_ns]
    assert read == [read[0] + number * APART_NS for number in range(12)], "each joint twice"
    assert read[0] - asked_ns <= APART_NS
    assert on[0] - read[-1] <= APART_NS
    moves = bench.times(servos.SERVO_MOVE)
    assert moves[0] == on[-1] + TORQUE_APART_NS
    assert moves[3] == moves[0] + PERIOD_NS
    groups = [data[3] for _, data in bench.frames if data[0] == servos.SERVO_MOVE]
    assert groups == [MOST_MOVES] * 4
    assert moves[:3] == [moves[0] + number * (PERIOD_NS // 3) for number in range(3)]


def first_move(bench: ArmBench, servo: int) -> int:
    """Goes on until this servo is moved; where to."""

    def moves() -> list[int]:
        frames = [data for _, data in bench.frames if data[0] == servos.SERVO_MOVE]
        return [to for data in frames for one, to in iter_unpack("<BH", data[4:]) if one == servo]

    bench.until(moves)
    return moves()[0]


def to_the_pose(bench: ArmBench) -> None:
    pose = bench.core.pose(goals.DRIVE, SERVICE, "me")
    assert pose
    bench.core.execute(pose, bench.now)


@pytest.mark.parametrize("loaded", [None, False], ids=["since power-on", "after a release"])
@pytest.mark.parametrize(
    ("start", "servo"),
    [
        (lambda bench: bench.execute((0.0, 500.0)), 1),
        (lambda bench: bench.goal(), 1),
        (lambda bench: bench.goal(goals.JOG), 1),
        (to_the_pose, 2),
    ],
    ids=["trajectory", "follow", "jog", "pose"],
)
def test_joint_without_torque_that_was_moved_by_hand_begins_where_it_is(
    bench: ArmBench, start: Callable[[ArmBench], object], servo: int, loaded: bool | None
) -> None:
    if loaded is False:
        bench.execute((0.0, 510.0), joints=6)
        bench.run(2.0)
        bench.core.release(bench.now)
        bench.run(2.0)
        bench.known().frames.clear()
    assert bench.core.joints[servo - 1].loaded is loaded
    bench.servos.change(servo, bench.now, position=800.0)
    start(bench)
    assert first_move(bench, servo) == pytest.approx(800, abs=10)


def test_joint_that_a_newer_goal_adds_begins_where_a_hand_has_moved_it(bench: ArmBench) -> None:
    bench.goal()
    bench.until(bench.core.streaming)
    first, second = bench.core.joints[:2]
    bench.servos.change(2, bench.now, position=800.0)
    bench.core.accept(Goal(goals.FOLLOW, ME, "client 11", bench.now, {first: 0.1, second: 0.1}), "", bench.now)
    assert first_move(bench, servo=2) == pytest.approx(800, abs=10)


def test_joint_without_torque_is_read_again_while_another_one_can_not_be(bench: ArmBench) -> None:
    bench.core.forget()
    trajectory = bench.execute((0.0, 600.0), joints=2)

    def move_the_shoulder(seconds: float) -> None:
        until_ns = bench.now + round(seconds * 1e9)
        while bench.now < until_ns:
            bench.servos.change(2, bench.now, position=300.0 + 300 * (len(bench.frames) % 2))
            bench.step()

    move_the_shoulder(1.0)
    assert trajectory.phase == goals.FINDING
    bench.servos.change(1, bench.now, position=800.0)
    move_the_shoulder(LIMP_NS * 1e-9)
    bench.servos.change(2, bench.now, position=500.0)
    assert first_move(bench, servo=1) == pytest.approx(800, abs=10)
    bench.until(lambda: trajectory.done)
    assert trajectory.outcome == ""


def test_joint_that_has_lost_its_power_and_fallen_begins_where_it_lies(bench: ArmBench) -> None:
    joint, servo = bench.core.joints[0], bench.servos.by_id[1]
    bench.execute((0.0, 510.0))
    bench.run(2.0)
    bench.servos.change(1, bench.now, silent=True)
    bench.until(lambda: joint.silent)
    servo.torque = False
    bench.servos.change(1, bench.now, silent=False, position=800.0)
    bench.until(lambda: not joint.silent)
    bench.frames.clear()
    bench.goal()
    assert first_move(bench, servo=1) == pytest.approx(800, abs=10)
    assert servo.torque


def test_joint_with_torque_moves_at_once(bench: ArmBench) -> None:
    """Nobody has moved it, so it is not read again."""
    bench.execute((0.0, 510.0))
    bench.run(2.0)
    assert bench.core.joints[0].loaded
    bench.frames.clear()
    bench.goal()
    bench.until_moves(1)
    assert bench.times(servos.POSITION) == []


def test_nothing_is_asked_while_it_moves_and_right_after(bench: ArmBench) -> None:
    trajectory = bench.execute((0.0, 600.0))
    bench.until(lambda: trajectory.done)
    moves, reads = bench.times(servos.SERVO_MOVE), bench.times(*servos.READS)
    assert min(t_ns for t_ns in reads if t_ns > moves[0]) >= moves[-1] + QUIET_NS
    assert trajectory.outcome == ""
    assert bench.now - moves[-1] <= QUIET_NS + PERIOD_NS + TICK


def test_frame_that_comes_late_shifts_no_other(bench: ArmBench) -> None:
    bench.execute((0.0, 900.0), joints=4)
    bench.until_moves(2)
    first, second = bench.times(servos.SERVO_MOVE)
    bench.now = first + PERIOD_NS + 15 * MS
    bench.look()
    assert bench.core.due_ns == max(second + PERIOD_NS, bench.now + MOVES_APART_NS)
    bench.step()
    bench.step()
    assert bench.times(servos.SERVO_MOVE)[4] == first + 2 * PERIOD_NS
    bench.now += 10 * PERIOD_NS
    bench.look()
    late_ns = bench.now
    assert bench.core.due_ns == late_ns + MOVES_APART_NS
    due_ns = bench.core.due_ns
    bench.now = due_ns - 1
    bench.look()
    bench.now = due_ns
    bench.look()
    assert bench.times(servos.SERVO_MOVE)[-2:] == [late_ns, late_ns + MOVES_APART_NS]
    bench.until(lambda: bench.times(servos.SERVO_MOVE)[-1] > late_ns + MOVES_APART_NS)
    assert bench.now == late_ns + PERIOD_NS


@pytest.mark.parametrize(("late_ms", "step_ms"), [(0, 40), (10, 50), (30, LONGEST_MOVE_MS), (500, LONGEST_MOVE_MS)])
def test_move_that_comes_late_makes_up_for_no_more_than_the_longest_move(late_ms: int, step_ms: int) -> None:
    bench = ArmBench().known()
    bench.goal(goals.JOG, rate=0.5)
    bench.until_moves(12)
    joint = bench.core.joints[0]
    before = joint.position
    bench.now = bench.core.due_ns + late_ms * MS
    bench.goal(goals.JOG, rate=0.5)
    bench.look()
    assert joint.position - before == pytest.approx(0.5 * PULSES_PER_RAD * step_ms * 1e-3)


@pytest.mark.parametrize(("sign", "rate"), [(1, 0.4), (-1, 0.4), (1, -0.02), (-1, -0.4)])
def test_jog_turns_by_its_rate_in_the_direction_of_the_angle(sign: int, rate: float) -> None:
    bench = ArmBench(joints__base__sign=sign).known()
    joint = bench.core.joints[0]
    bench.goal(goals.JOG, rate=rate)
    bench.until_moves(6)
    begin = joint.rad(joint.position)
    for moves in range(12, 36, 6):
        bench.goal(goals.JOG, rate=rate)
        bench.until_moves(moves)
    assert joint.rad(joint.position) - begin == pytest.approx(rate * 24 * PERIOD_NS * 1e-9)


def test_first_step_is_one_of_a_period_from_rest(bench: ArmBench) -> None:
    joint = bench.core.joints[0]
    for _ in range(2):
        bench.known().goal(goals.JOG, rate=1.0)
        begin, count = joint.position, len(bench.times(servos.SERVO_MOVE))
        bench.until_moves(count + 1)
        assert joint.position - begin == pytest.approx(joint.acceleration * (PERIOD_NS * 1e-9) ** 2)
        bench.run(1.5)


@pytest.mark.parametrize("age_ns", [0, -10 * TIMEOUT_NS], ids=["", "of the future, from now"])
def test_goal_counts_for_its_time_to_the_nanosecond(bench: ArmBench, age_ns: int) -> None:
    bench.goal(age_ns=age_ns)
    for elapsed_ns, counts in ((0, True), (TIMEOUT_NS, True), (1, False)):
        bench.now += elapsed_ns
        assert bench.core.publisher(OTHER, bench.now) == ("client 11" if counts else "")
        assert bench.core.publisher(ME, bench.now) == ""
        if elapsed_ns:
            bench.look()
            assert (bench.core.moved_by(ME), bench.core.moved_by(OTHER)) == (counts, False)


def test_journey_is_its_client_s_but_for_the_service_s(bench: ArmBench) -> None:
    trajectory = bench.execute((5.0, 600.0))
    assert bench.core.publisher(OTHER, bench.now) == "client 11"
    assert bench.core.publisher(ME, bench.now) == ""
    assert bench.core.moved_by(ME)
    bench.goal()
    assert bench.core.followed is trajectory, "a trajectory before a stream"
    bench.execute((5.0, 600.0), session=SERVICE)
    assert (trajectory.done, trajectory.dropped, trajectory.outcome) == (True, True, "preempted")
    assert bench.core.publisher(OTHER, bench.now) == ""
    bench.goal(session=OTHER)
    assert isinstance(bench.core.followed, Goal), "who streams goes before the service's trajectories"


def test_closed_while_motion_is_enabled(bench: ArmBench) -> None:
    bench.gate.enable()
    bench.goal()
    assert bench.core.why_not(bench.now) == bench.gate.core.arm_closed() == "wheels enabled"
    assert bench.core.followed is None


def test_goal_that_is_not_renewed_holds_the_arm_once_and_beside_a_journey_nothing(bench: ArmBench) -> None:
    goal = bench.goal()
    bench.run(0.3)
    assert bench.core.streaming()
    bench.holds.clear()
    bench.run(1.0)
    assert len(bench.holds) == 1
    assert 0 < bench.holds[0] - goal.t_ns - TIMEOUT_NS <= TICK
    assert not bench.core.streaming()
    bench.goal()
    bench.run(0.2)
    trajectory = bench.execute((2.0, 600.0))
    bench.goal()
    bench.holds.clear()
    bench.until(lambda: trajectory.done)
    assert (bench.holds, trajectory.outcome) == ([], "")


def test_ended_stream_counts_again_after_its_timeout_or_its_pause(bench: ArmBench) -> None:
    bench.goal()
    bench.core.stop("stopped")
    for _ in range(3):
        bench.now += TIMEOUT_NS
        bench.goal()
        assert bench.core.why_not(bench.now) == ENDED
    bench.now += TIMEOUT_NS + 1
    bench.goal()
    assert bench.core.why_not(bench.now) == ""
    for but, why in ((ME, ""), (OTHER, ENDED), (None, ENDED)):
        bench.core.stop("stopped", but=but)
        bench.goal()
        assert bench.core.why_not(bench.now) == why
        bench.core.pause(ME)
        bench.goal()
        assert bench.core.why_not(bench.now) == ""


def test_other_joints_of_a_goal_are_held_and_begin_together(bench: ArmBench) -> None:
    bench.goal()
    bench.run(0.2)
    bench.holds.clear()
    joints = bench.core.joints
    bench.core.accept(Goal(goals.FOLLOW, ME, "client 11", bench.now, {joints[1]: 0.1, joints[0]: 0.1}), "", bench.now)
    bench.look()
    assert bench.holds == [bench.now]
    assert not bench.core.streaming()
    bench.until(bench.core.streaming)
    assert all(joint.known for joint in joints)


def test_journey_that_pauses_at_its_end_is_not_over_before_its_time(bench: ArmBench) -> None:
    trajectory = bench.execute((1.0, 550.0), (3.0, 550.0))
    bench.until(bench.core.streaming)
    began_ns = bench.now
    bench.until(lambda: trajectory.phase != goals.ON_ITS_WAY)
    assert 3000 * MS <= bench.now - began_ns <= 3000 * MS + 2 * PERIOD_NS
    assert trajectory.phase == goals.SETTLING
    settling_ns = bench.now
    bench.until(lambda: trajectory.phase != goals.SETTLING)
    assert (trajectory.phase, bench.now - settling_ns >= QUIET_NS) == (goals.CHECKING, True)
    assert bench.until(lambda: trajectory.done) < 0.2


def test_joint_that_is_not_there_at_its_time_has_lost_its_way(bench: ArmBench) -> None:
    slow = ArmBench(joints__base__acceleration_radps2=0.05, joints__base__speed_radps=6.0).known()
    trajectory = slow.execute((0.5, 800.0))
    slow.until(slow.core.streaming)
    began_ns = trajectory.begun_ns
    slow.until(lambda: trajectory.done)
    assert trajectory.outcome == "it did not get there in time"
    assert 0 < slow.now - began_ns - (500 * MS + LOST_NS) <= PERIOD_NS
    assert not slow.core.streaming()


ALL = "joints base, shoulder, elbow, wrist, roll, gripper: no answer from servos 1, 2, 3, 4, 5, 10"


@pytest.mark.parametrize(
    ("silent", "told"),
    [
        *(((1,), "joint base: no answer from servo 1"), ((1, 3), "joints base, elbow: no answer from servos 1, 3")),
        (SERVOS, ALL),
    ],
)
def test_silent_servos_end_a_journey_once_all_were_asked(bench: ArmBench, silent: tuple[int, ...], told: str) -> None:
    bench.core.forget()
    for servo in silent:
        bench.servos.change(servo, bench.now, silent=True)
    asked = len(bench.frames)
    trajectory = bench.execute((0.0, 600.0), joints=6)
    bench.until(lambda: trajectory.done)
    assert trajectory.outcome == told
    assert len([data for _, data in bench.frames[asked:] if data[1] == silent[0]]) == MOST_MISSES
    assert not bench.core.streaming()


def test_place_that_can_not_be_read_in_time_ends_a_trajectory(bench: ArmBench) -> None:
    bench.core.forget()
    trajectory = bench.execute((0.0, 600.0))
    begun_ns = bench.now
    while not trajectory.done:
        bench.servos.change(1, bench.now, position=300.0 + 300 * (len(bench.frames) % 2))
        bench.step()
    assert trajectory.outcome == "joint base: where it is can't be read"
    assert 0 < bench.now - begun_ns - FIND_NS <= 2 * APART_NS


def test_stream_that_a_joint_keeps_from_beginning_says_which(bench: ArmBench) -> None:
    base, shoulder = bench.core.joints[:2]

    def stream(seconds: float) -> None:
        """A client that goes on with its goals for both joints."""
        until_ns = bench.now + round(seconds * 1e9)
        while bench.now < until_ns:
            bench.core.accept(Goal(goals.FOLLOW, ME, "client 11", bench.now, {base: 0.1, shoulder: 0.1}), "", bench.now)
            bench.step()

    bench.servos.change(2, bench.now, silent=True)
    bench.until(lambda: shoulder.silent)
    stream(0.5)
    assert not bench.core.streaming()
    assert bench.core.why_not(bench.now) == "joint shoulder: no answer from servo 2"
    bench.servos.change(2, bench.now, silent=False)
    stream(1.0)
    assert bench.core.streaming()
    assert bench.core.why_not(bench.now) == ""


def test_stream_whose_joint_is_kept_moving_by_hand_says_that_it_can_not_be_read(bench: ArmBench) -> None:
    bench.core.forget()
    begun_ns, told = bench.now, ""
    while not told:
        assert bench.now - begun_ns <= FIND_NS + 2 * APART_NS
        bench.servos.change(1, bench.now, position=300.0 + 300 * (len(bench.frames) % 2))
        bench.goal()
        bench.step()
        told = bench.core.why_not(bench.now)
    assert told == "joint base: where it is can't be read"
    assert bench.now - begun_ns > FIND_NS


@pytest.mark.parametrize(("off", "told"), [(-26, ""), (26, ""), (33, "is 3"), (-33, "is 3")])
def test_journey_is_there_when_its_joints_are_read_near_its_end(bench: ArmBench, off: int, told: str) -> None:
    trajectory = bench.execute((1.0, 600.0))
    bench.until(lambda: trajectory.phase == goals.SETTLING)
    bench.servos.change(1, bench.now, position=600.0 + off)
    bench.until(lambda: trajectory.done)
    assert trajectory.outcome.startswith(told and f"joint base (servo 1) {told}")
    assert bool(trajectory.outcome) == bool(told)


def test_joint_is_off_beyond_the_tolerance_and_a_pose_named_when_none_judged_is(bench: ArmBench) -> None:
    core, joint = bench.core, bench.core.joints[0]
    off = "is 31 pulses off"
    for measured, told in ((530, ""), (470, ""), (531, off), (469, off), (None, "was not read")):
        joint.measured = measured
        assert core.off({joint: 500.0}) == (f"joint base (servo 1) {told}" if told else "")
    tuck = {joint.name: joint.tuck for joint in core.joints}
    for places, name in (({}, "drive"), ({"base": 1, "gripper": 1}, "drive"), (tuck, "tuck"), ({"elbow": 90}, "")):
        for joint in core.joints:  # base and gripper are not judged
            joint.measured = places.get(joint.name, joint.drive)
        assert core.pose_name() == name
    assert core.off(core.judged("drive")).startswith("joint elbow (servo 3) is 39")
    core.joints[2].measured = core.joints[2].drive
    core.joints[1].known = False
    assert core.pose_name() == "", "all that is judged must be known"


@pytest.mark.parametrize(("position", "first"), [(-20.0, 0.0), (1020.0, 1000.0)])
def test_servo_beyond_what_a_move_can_say_begins_at_its_nearest(position: float, first: float) -> None:
    bench = ArmBench()
    bench.servos.change(1, T0, position=position)
    bench.known().goal(rate=0.0)
    assert bench.core.joints[0].position == first
    bench.until(lambda: bench.times(servos.SERVO_MOVE))
    assert abs(bench.core.joints[0].position - first) < 10


def test_way_to_a_pose_takes_its_joints_there_at_the_share_of_their_speed() -> None:
    bench = ArmBench(arm__pose_speed=0.25, joints__elbow__drive=-1).known()
    trajectory = bench.core.pose(goals.DRIVE, SERVICE, "me")
    assert trajectory
    assert [joint.name for joint in trajectory.joints] == ["shoulder", "wrist", "roll", "gripper"]
    assert [trajectory.ends[joint] for joint in trajectory.joints] == [793, 160, 499, 499]
    assert (trajectory.purpose, trajectory.who, trajectory.session) == ("drive", "me", SERVICE)
    bench.core.execute(trajectory, bench.now)
    bench.until(bench.core.streaming)
    assert trajectory.length_s == pytest.approx(340 / (0.25 * PULSES_PER_RAD), abs=0.1)
    bench.until(lambda: trajectory.done, most_s=20.0)
    assert trajectory.outcome == ""
    nowhere = {f"joints__{joint.name}__tuck": -1 for joint in bench.core.joints}
    assert ArmBench(**nowhere).core.pose(goals.TUCK, SERVICE, "me") is None
