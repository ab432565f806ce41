"""The reader of the arm's servos, what it asks when and which answers count; and a joint's angles and steps, none of
them faster than it may be."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby, pairwise
from math import pi

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.board.servos import POSITION, SUPPLY, TEMPERATURE, TORQUE
from failstop.policy.joints import MOST_MISSES, Joint, from_settings, too_far
from failstop.policy.settings import Settings
from failstop.procs.gate.arm.goals import MOVE, Trajectory, too_fast, too_fast_between
from failstop.procs.gate.arm.reader import AGREE, APART_NS, IDLE_NS, LOOKS_APART_NS, QUIET_NS, WAIT_NS, ServoReader

T0 = 100_000_000_000
ANSWERED_NS = 2_000_000


class Bench:
    """A reader of two joints, or as many as there are servos, whose questions come exactly when they are due."""

    def __init__(self, servos: tuple[int, ...] = (4, 9)) -> None:
        self.joints = from_settings(Settings({f"joints.{'abc'[at]}.servo": servo for at, servo in enumerate(servos)}))
        self.reader = ServoReader(self.joints, T0)
        self.now = T0

    def ask(self, *wanted: Joint) -> tuple[Joint, int]:
        """The next question; none comes a nanosecond before it is due."""
        due_ns = self.reader.due_ns()
        assert self.reader.ask(list(wanted), max(self.now, due_ns - 1)) is None
        self.now = due_ns
        question = self.reader.ask(list(wanted), due_ns)
        assert question
        return question

    def say(self, question: tuple[Joint, int], value: int | None) -> Joint | None:
        """The board's answer to it, some time later."""
        self.now += ANSWERED_NS
        return self.reader.answer(question[0].servo, question[1], value, self.now)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("servos", [(4, 9), (4, 9, 2)])
def test_wanted_joints_are_asked_in_turn_at_first_twice_as_fast_as_the_bus_allows(servos: tuple[int, ...]) -> None:
    bench, count = Bench(servos), len(servos)
    questions, times = [], []
    for _ in range(4 * count):
        questions.append(bench.ask(*bench.joints))
        times.append(bench.now)
        bench.say(questions[-1], 500)
    assert times[0] == T0 + QUIET_NS, "the first waits until every servo stands"
    assert {what for _, what in questions} == {POSITION}
    assert [len(list(asked)) for _, asked in groupby(questions)] == [2] * count + [1] * 2 * count
    assert {len(set(questions[at : at + count])) for at in range(2 * count, 4 * count, count)} == {count}
    assert {after - before for before, after in pairwise(times)} == {APART_NS}
    assert bench.reader.free_ns() == times[-1] + APART_NS
    bench.reader.moved(bench.now + 7 * IDLE_NS)
    assert bench.reader.due_ns() == bench.now + 7 * IDLE_NS + QUIET_NS, "and again after a move"
    bench.ask()


@pytest.mark.parametrize(
    ("count", "looks"),
    [(2, [[1, 2], [1, 2]]), (5, [[1, 2, 3], [4, 5], [1, 2, 3]]), (6, [[1, 2, 3], [4, 5, 6], [1, 2, 3]])],
)
def test_looks_go_over_the_joints_a_few_at_a_time(count: int, looks: list[list[int]]) -> None:
    joints = from_settings(Settings({f"joints.j{servo}.servo": servo for servo in range(1, count + 1)}))
    reader = ServoReader(joints, T0)
    for step, servos in enumerate(looks):
        due_ns = T0 + step * LOOKS_APART_NS
        assert reader.look_ns == due_ns
        assert reader.look(due_ns - 1) == []
        assert [joint.servo for joint in reader.look(due_ns)] == servos


def test_a_joint_on_its_way_is_where_one_reading_says(bench: Bench) -> None:
    other, seen = bench.joints
    seen.misses = MOST_MISSES
    bench.reader.seen(9, 512, T0 + 5)
    assert (seen.measured, seen.measured_ns, seen.misses, seen.known) == (512, T0 + 5, 0, False)
    assert (other.measured, other.measured_ns) == (None, 0)


def test_an_idle_reader_asks_each_joint_twice_for_its_place_and_once_for_the_rest(bench: Bench) -> None:
    asked = []
    for _ in range(18):
        question = bench.ask()
        asked.append((question[0].name, question[1]))
        begun_ns = bench.now
        bench.say(question, 40)
        assert bench.reader.due_ns() == begun_ns + IDLE_NS
    assert asked == [
        (name, what) for other in (TEMPERATURE, TORQUE, SUPPLY) for name in "ab" for what in (POSITION, POSITION, other)
    ]
    for joint in bench.joints:
        assert (joint.measured, joint.temperature_c, joint.supply_mv, joint.loaded) == (40, 40, 40, True)


def test_a_client_that_waits_ends_an_idle_pause_but_not_the_bus_s(bench: Bench) -> None:
    assert bench.reader.free_ns() == 0
    bench.say(bench.ask(), 500)
    asked_ns = bench.now - ANSWERED_NS
    bench.reader.hurry(bench.now)
    assert bench.reader.due_ns() == asked_ns + APART_NS
    bench.say(bench.ask(), 500)
    bench.reader.hurry(bench.now + 2 * APART_NS)
    assert bench.reader.due_ns() == bench.now + 2 * APART_NS
    bench.reader.hurry(bench.now + 10 * IDLE_NS)
    assert bench.reader.due_ns() == bench.now + 2 * APART_NS
    bench.ask()
    due_ns = bench.reader.due_ns()
    bench.reader.hurry(bench.now)
    assert bench.reader.due_ns() == due_ns == bench.now + WAIT_NS


@pytest.mark.parametrize(
    ("first", "second", "measured"), [(500, 504, 502), (504, 499, 502), (500, 506, None), (506, 500, None)]
)
def test_place_counts_when_two_readings_agree(bench: Bench, first: int, second: int, measured: int | None) -> None:
    joint = bench.joints[0]
    assert bench.say(bench.ask(joint), first) is None
    assert joint.measured is None
    found = bench.say(bench.ask(joint), second)
    assert (found, joint.measured) == ((joint, measured) if measured else (None, None))
    assert joint.measured_ns == (bench.now if measured else 0)
    assert bench.say(bench.ask(joint), second + AGREE) is joint
    assert not joint.misses


@pytest.mark.parametrize("lost", [None, 0])
def test_an_answer_behind_one_of_no_servo_or_of_0_counts_for_nothing(bench: Bench, lost: int | None) -> None:
    joint = bench.joints[0]
    bench.say(bench.ask(joint), 500)
    assert bench.say(bench.ask(joint), lost) is None
    assert (joint.misses, joint.unpaired) == (1, None)
    assert bench.say(bench.ask(joint), 0) is None, "the late answer"
    assert joint.misses == 1
    assert bench.say(bench.ask(joint), 500) is None
    assert joint.misses == 0
    assert bench.say(bench.ask(joint), 500) is joint


@pytest.mark.parametrize("before", [500, None], ids=["after an answer", "from the beginning"])
def test_servo_that_gives_no_answer_is_silent_until_something_answers(bench: Bench, before: int | None) -> None:
    joint = bench.joints[0]
    if before:
        bench.say(bench.ask(joint), before)
    joint.loaded = True
    bench.ask(joint)
    for number in range(1, MOST_MISSES + 3):
        begun_ns = bench.now
        question = bench.ask(joint)
        assert bench.now == begun_ns + WAIT_NS
        assert joint.unpaired is None
        assert joint.misses == min(number, MOST_MISSES)
        assert joint.loaded is (None if joint.silent else True), "it may have lost its power"
    assert joint.silent
    assert bench.say(question, 300) is None
    assert (joint.silent, joint.misses) == (False, 0)
    assert joint.unpaired is None, "it may be the value of another question"


def test_where_a_servo_stands_and_its_torque_are_unknown_once_it_is_silent(bench: Bench) -> None:
    """Its plug may be loose, and the joint may sag without torque."""
    joint = bench.joints[0]
    joint.known = joint.loaded = True
    bench.ask(joint)
    for misses in range(1, MOST_MISSES + 2):
        assert (joint.known, joint.loaded) == ((True, True) if misses <= MOST_MISSES else (False, None))
        bench.ask(joint)


@pytest.mark.parametrize("on", [False, True])
def test_torque_is_the_only_answer_that_may_be_0_and_says_nothing_of_the_cable(bench: Bench, on: bool) -> None:
    joint = bench.joints[0]
    while (question := bench.ask())[1] != TORQUE or question[0] is not joint:
        bench.say(question, 500)
    joint.misses = 2
    assert bench.say(question, int(on)) is None
    assert joint.loaded is on
    assert joint.misses == 2
    assert bench.say(bench.ask(joint), 500) is joint, "and nothing after it is distrusted"
    assert joint.misses == 0


def test_answer_to_another_question_is_not_taken(bench: Bench) -> None:
    joint, other = bench.joints
    assert bench.reader.answer(joint.servo, POSITION, 500, bench.now) is None
    question = bench.ask(joint)
    assert bench.say((other, POSITION), 500) is None
    assert bench.say((joint, SUPPLY), 7000) is None
    assert (joint.unpaired, joint.supply_mv) == (None, 0)
    bench.say(question, 500)
    assert joint.unpaired == 500
    assert bench.say(question, 500) is None, "it was answered"


STEP_S = 0.04
MARGIN = 1e-6


def joint(position: float = 500.0, **changed: object) -> Joint:
    table = {f"joints.elbow.{key}": value for key, value in {"servo": 7, **changed}.items()}
    found = from_settings(Settings(table))[0]
    found.position, found.known = position, True
    return found


def went(it: Joint, step: Callable[[Joint], None], steps: int) -> list[float]:
    """Its positions, from where it stands on."""
    found = [it.position]
    for _ in range(steps):
        step(it)
        found.append(it.position)
    return found


def speeds(positions: list[float]) -> list[float]:
    return [(after - before) / STEP_S for before, after in pairwise(positions)]


def assert_within(it: Joint, positions: list[float], most: float) -> None:
    """No speed beyond `most`, and no change of it beyond its ramp, but for what the last step cuts off."""
    found = [0.0, *speeds(positions)]
    assert max(map(abs, found)) <= most + MARGIN
    assert max(abs(after - before) for before, after in pairwise(found)) <= 1.15 * it.acceleration * STEP_S


def test_angle_is_counted_from_the_zero_in_the_direction_of_the_sign() -> None:
    it = joint(zero=400, sign=-1, low=100, high=900)
    assert it.pulses(pi / 2) == pytest.approx(400 - 375)
    assert it.rad(25.0) == pytest.approx(pi / 2)
    assert it.range_rad() == pytest.approx((-500 / PULSES_PER_RAD, 300 / PULSES_PER_RAD))
    assert joint().pulses(pi / 2) == pytest.approx(875)
    assert joint().rad(875) == pytest.approx(pi / 2)


def test_base_is_judged_for_driving_by_its_own_setting() -> None:
    names = ("base", "elbow")
    table: dict[str, object] = {f"joints.{name}.servo": number for number, name in enumerate(names, 3)}
    table |= {f"joints.{name}.drive": 450 for name in names} | {"arm.base_servo": 3}
    for pan, drive, judged in ((-1, -1, False), (0, 0, True), (700, 700, True)):
        base, elbow = from_settings(Settings({**table, "arm.drive_pan": pan}))
        assert (base.drive, base.judged) == (drive, judged)
        assert (elbow.drive, elbow.judged) == (450, True)
    assert not from_settings(Settings({**table, "joints.elbow.judged": "off"}))[1].judged


def test_joint_is_told_where_it_is_while_that_is_known() -> None:
    it = joint(500.126)
    it.measured, it.measured_ns, it.loaded, it.temperature_c, it.supply_mv = 501, 17, True, 35, 7400
    assert it.state() == ("elbow", 7, 500.13, 501, 17, True, 35, 7400)
    it.velocity, it.unpaired = 3.0, 500
    it.forget()
    assert (it.state()[2], it.velocity, it.unpaired, it.silent) == (None, 0.0, None, False)
    it.misses = MOST_MISSES
    assert it.silent


@given(begin=st.floats(100, 900), target=st.floats(100, 900), share=st.floats(0.1, 1.0))
@example(begin=100.0, target=900.0, share=1.0)
@example(begin=500.0, target=500.0, share=1.0)
def test_follow_gets_there_by_its_ramps_and_stays(begin: float, target: float, share: float) -> None:
    it = joint(begin, low=100, high=900)
    most = it.speed * share
    ramp_s = most / it.acceleration
    steps = round((abs(target - begin) / most + ramp_s) / STEP_S) + 10
    positions = went(it, lambda it: it.step_towards(target, share, STEP_S), steps)
    assert_within(it, positions, most)
    assert it.position == pytest.approx(target, abs=0.01)
    assert all(min(begin, target) - 0.5 < position < max(begin, target) + 0.5 for position in positions)


@given(begin=st.floats(100, 900), rate=st.floats(-400, 400))
@example(begin=100.0, rate=400.0)
@example(begin=900.0, rate=-400.0)
@example(begin=500.0, rate=0.5)
@example(begin=500.0, rate=-0.5)
@example(begin=500.0, rate=0.0)
def test_jog_keeps_its_rate_and_ends_at_the_bound(begin: float, rate: float) -> None:
    it = joint(begin, low=100, high=900, acceleration_radps2=2.0)
    positions = went(it, lambda it: it.jog(rate, STEP_S), 400)
    most = min(abs(rate), it.speed)
    assert_within(it, positions, most)
    assert all(100 <= position <= 900 for position in positions)
    ramp = it.acceleration * STEP_S
    stands = 900 if rate > 0 else 100
    for number, (position, speed) in enumerate(zip(positions, speeds(positions), strict=False), 1):
        room = abs(stands - position)
        if room > most * most / it.acceleration + 3 * most * STEP_S:
            assert abs(speed) == pytest.approx(min(most, number * ramp), abs=1e-6), "as fast as it may"
    if most > 300:
        assert it.position == pytest.approx(stands, abs=0.01)
        assert it.velocity == pytest.approx(0.0, abs=0.5)


@given(
    outside=st.sampled_from((0.0, 20.0, 99.0, 901.0, 950.0, 1000.0)),
    rate=st.sampled_from((-200.0, -1.0, 0.0, 1.0, 200.0)),
)
def test_joint_beyond_its_bounds_returns_no_faster_than_it_may(outside: float, rate: float) -> None:
    """Turned there by hand. It is sent no further out, and in without a leap."""
    inward = (rate > 0) == (outside < 500) and bool(rate)
    it = joint(outside, low=100, high=900)
    positions = went(it, lambda it: it.jog(rate, STEP_S), 200)
    assert_within(it, positions, abs(rate))
    assert (it.position != outside) == inward
    it = joint(outside, low=100, high=900)
    positions = went(it, lambda it: it.step_towards(500.0, 1.0, STEP_S), 200)
    assert_within(it, positions, it.speed)
    assert it.position == pytest.approx(500.0, abs=0.01)


def test_goal_at_a_bound_is_allowed_and_none_beyond() -> None:
    it = joint(low=100, high=900, speed_radps=2.0)
    low, high = it.range_rad()
    for angle in (low, high, low - 9e-7, high + 9e-7):
        assert too_far({it: angle}) == ""
    for angle in (low - 2e-6, high + 2e-6, float("nan")):
        assert too_far({it: angle}) == f"joint elbow to {angle:g} rad: allowed is {low:.3f} to {high:.3f}"
    for rate in (2.0, -2.0, 0.0):
        assert too_fast({it: rate}) == ""
    for rate in (2.0001, -2.0001, float("-inf")):
        assert too_fast({it: rate}) == f"joint elbow at {rate:g} rad/s: allowed is up to 2"


def test_rows_of_a_trajectory_go_up_in_time_and_no_faster_than_each_joint_may() -> None:
    it = joint(speed_radps=2.0)
    rad = PULSES_PER_RAD
    assert too_fast_between([(0.0, {it: 0.0}), (1.0, {it: 2.0 * rad}), (3.0, {it: -2.0 * rad})]) == ""
    assert too_fast_between([(0.0, {it: 0.0}), (1.0, {it: 0.0}), (2.0, {it: 2.1 * rad})]) == (
        "joint elbow at 2.100 rad/s between 1 and 2 s: allowed is up to 2"
    )
    assert "at 2.100 rad/s between 1 and 3 s" in too_fast_between([(1.0, {it: 4.2 * rad}), (3.0, {it: 0.0})])
    for times in ((1.0, 1.0), (2.0, 1.0)):
        rows = [(t_s, {it: 0.0}) for t_s in times]
        assert too_fast_between(rows) == "the times do not go up: {:g} s, then {:g} s".format(*times)


def test_journey_goes_straight_from_row_to_row_from_where_it_begins() -> None:
    it = joint(120.0)
    way = Trajectory(MOVE, 1, "me", [it], [(1.0, {it: 220.0}), (3.0, {it: 100.0})])
    assert (way.left_s(T0), way.begin(T0)) == (0.0, "")
    rows = ((0.0, 120.0), (0.25, 145.0), (1.0, 220.0), (1.5, 190.0), (2.9, 106.0), (3.0, 100.0), (9.0, 100.0))
    for t_s, there in rows:
        assert way.targets(T0 + round(t_s * 1e9))[it] == pytest.approx(there)
        assert way.left_s(T0 + round(t_s * 1e9)) == pytest.approx(max(0.0, 3.0 - t_s))


@pytest.mark.parametrize(("share", "end", "takes_s"), [(1.0, 500.0, 1.0), (0.5, 500.0, 2.0), (1.0, 251.0, 0.1)])
def test_journey_without_a_time_takes_what_its_slowest_joint_needs(share: float, end: float, takes_s: float) -> None:
    joints = from_settings(Settings({"joints.a.servo": 1, "joints.b.servo": 2, "joints.a.speed_radps": 2.0}))
    slow_pulses = joints[1].speed * (end - 250.0) / 250.0
    way = Trajectory(MOVE, 1, "me", joints, [(0.0, {joints[0]: 10.0, joints[1]: slow_pulses})], share)
    assert way.begin(T0) == ""
    assert way.length_s == pytest.approx(takes_s)
