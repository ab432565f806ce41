"""The reader of the arm's servos: what it asks when, and which answers count."""

from __future__ import annotations

from itertools import groupby, pairwise

import pytest

from failstop.board.servos import POSITION, SUPPLY, TEMPERATURE, TORQUE
from failstop.policy.joints import MOST_MISSES, Joint, from_settings
from failstop.policy.settings import Settings
from failstop.procs.gate.arm.reader import AGREE, APART_NS, IDLE_NS, QUIET_NS, WAIT_NS, ServoReader

T0 = 100_000_000_000
ANSWERED_NS = 2_000_000


class Bench:
    """A reader of two joints, whose questions come exactly when they are due."""

    def __init__(self) -> None:
        self.joints = from_settings(Settings({"joints.a.servo": 4, "joints.b.servo": 9}))
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


def test_first_question_waits_until_every_servo_stands(bench: Bench) -> None:
    bench.ask()
    assert bench.now == T0 + QUIET_NS


def test_wanted_joints_are_asked_in_turn_at_first_twice_as_fast_as_the_bus_allows(bench: Bench) -> None:
    questions, times = [], []
    for _ in range(8):
        questions.append(bench.ask(*bench.joints))
        times.append(bench.now)
        bench.say(questions[-1], 500)
    assert {what for _, what in questions} == {POSITION}
    assert [len(list(asked)) for _, asked in groupby(questions)] == [2, 2, 1, 1, 1, 1]
    assert [after - before for before, after in pairwise(times)] == [APART_NS] * 7
    assert bench.reader.free_ns() == times[-1] + APART_NS


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


def test_no_question_after_a_move_before_the_servo_stands(bench: Bench) -> None:
    bench.say(bench.ask(), 500)
    bench.reader.moved(bench.now + 7 * IDLE_NS)
    assert bench.reader.due_ns() == bench.now + 7 * IDLE_NS + QUIET_NS
    bench.ask()


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


def test_servo_that_gives_no_answer_is_silent_until_something_answers(bench: Bench) -> None:
    joint = bench.joints[0]
    bench.say(bench.ask(joint), 500)
    bench.ask(joint)
    for number in range(1, MOST_MISSES + 3):
        begun_ns = bench.now
        question = bench.ask(joint)
        assert bench.now == begun_ns + WAIT_NS
        assert joint.unpaired is None
        assert joint.misses == min(number, MOST_MISSES)
    assert joint.silent
    assert bench.say(question, 300) is None
    assert not joint.silent
    assert joint.unpaired is None, "it may be the value of another question"


def test_torque_is_the_only_answer_that_may_be_0_and_says_nothing_of_the_cable(bench: Bench) -> None:
    joint = bench.joints[0]
    while (question := bench.ask())[1] != TORQUE or question[0] is not joint:
        bench.say(question, 500)
    joint.misses = 2
    assert bench.say(question, 0) is None
    assert joint.loaded is False
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
