"""An answer or an echo never proves a write that the board may not have handled yet."""

from __future__ import annotations

import random

import pytest

from failstop.board.handled import GIVEN_UP_NS, Answers, Echo
from failstop.procs.loop import Timer
from failstop.procs.schedule import Pings
from tests.support.amounts import amount

MS = 1_000_000
S = 1_000 * MS
FORWARD, SLOWER, ZERO = (28.0, 28.0), (27.0, 27.0), (0.0, 0.0)


def test_an_answer_to_an_older_question_proves_that_one() -> None:
    answers = Answers()
    for at_ns in (1 * S, 2 * S):
        answers.asked(0, at_ns)
    assert answers.answered((0,), 2 * S + MS) == 1 * S
    assert answers.answered((0,), 2 * S + 2 * MS) == 2 * S
    assert answers.answered((0,), 2 * S + 3 * MS) == 0, "one that nobody has asked for"


def test_an_answer_that_another_overtook_was_lost() -> None:
    answers = Answers()
    for index, at_ns in ((0, 1), (1, 2), (0, 3)):
        answers.asked(index, at_ns)
    assert [answers.answered((index,), 9) for index in (1, 0, 0)] == [2, 3, 0]


def test_an_answer_that_came_before_the_question_is_none_to_it() -> None:
    answers = Answers()
    answers.asked(0, 5)
    assert answers.answered((0,), 4) == 0


def test_a_question_that_was_not_answered_for_long_never_will_be() -> None:
    answers = Answers()
    for at_ns in (1, GIVEN_UP_NS):
        answers.asked(0, at_ns)
    assert answers.answered((0,), GIVEN_UP_NS + 2) == GIVEN_UP_NS


def test_an_answer_that_may_be_to_either_of_two_questions_counts_once_and_as_the_older_one() -> None:
    answers = Answers()
    for index, at_ns in ((1, 1), (0, 2)):
        answers.asked(index, at_ns)
    assert [answers.answered((0, 1), 9) for _ in range(3)] == [1, 2, 0]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_no_answer_proves_a_later_question_than_its_own_and_losses_are_made_up_for(count: int) -> None:
    """Questions and answers are lost and late at random; the one who draws them knows the truth."""
    for seed in range(amount(20, 1_000)):
        rng = random.Random(f"{count} {seed}")
        answers, pings = Answers(), Pings(count, 100 * MS, Timer(), rng.randrange(1 << 40))
        way: list[tuple[int, int, int]] = []
        now_ns = done_ns = behind_ns = 0
        for turn in range(400):
            now_ns += rng.randrange(50, 150) * MS
            lossy = turn < 200
            answers.asked(pings.index, now_ns)
            if not (lossy and rng.random() < 0.3):
                done_ns = max(done_ns + 1, now_ns + rng.randrange(0, 4_000 if lossy else 40) * MS)
                way.append((done_ns, pings.index, now_ns))
            pings.sent(now_ns)
            while way and way[0][0] <= now_ns:
                came_ns, index, asked_ns = way.pop(0)
                proved_ns = answers.answered((index,), came_ns)
                assert 0 < proved_ns <= asked_ns
                behind_ns = asked_ns - proved_ns
        assert count == 1 or behind_ns == 0, "19 s after the last loss nothing lags behind"


def moved(fades_ns: int = 800 * MS) -> Echo:
    """A board that says since 0.3 s that it obeys the motion that was written at 1 s."""
    echo = Echo(fades_ns)
    echo.obeyed(ZERO, 500 * MS)
    echo.wrote(FORWARD, 1 * S)
    assert echo.obeyed(FORWARD, 1 * S + 300 * MS) == 0
    return echo


def test_an_echo_that_followed_motion_proves_the_stop_that_it_follows() -> None:
    echo = moved()
    echo.wrote(ZERO, 1 * S + 400 * MS)
    assert echo.obeyed(ZERO, 1 * S + 420 * MS) == 1 * S + 400 * MS
    assert echo.obeyed(ZERO, 1 * S + 430 * MS) == 0, "and no later one"
    echo.wrote(FORWARD, 2 * S)
    echo.wrote(ZERO, 3 * S)
    assert echo.obeyed(ZERO, 3 * S + 10 * MS) == 0


def test_an_echo_of_zeros_that_followed_no_motion_proves_nothing() -> None:
    echo = Echo(800 * MS)
    echo.wrote(ZERO, 1)
    assert echo.obeyed(ZERO, 2) == 0
    echo.wrote(FORWARD, 3)
    echo.wrote(ZERO, 4)
    assert echo.obeyed(ZERO, 5) == 0


@pytest.mark.parametrize(("came_ms", "proves"), [(1_699, True), (1_700, False), (1_900, False)])
def test_zeros_that_its_own_watchdog_may_have_set_prove_nothing(came_ms: int, proves: bool) -> None:
    echo = moved()
    echo.wrote(ZERO, 1_500 * MS)
    assert (echo.obeyed(ZERO, came_ms * MS) > 0) == proves


def test_a_steady_speed_says_that_frames_arrive_by_its_marks() -> None:
    echo = moved()
    for turn in range(20):
        now_ns = 1_400 * MS + turn * 200 * MS
        mark = (SLOWER, FORWARD)[turn % 2]
        echo.wrote(mark, now_ns)
        echo.obeyed(mark, now_ns + 20 * MS)
    stopped_ns = 5_390 * MS
    echo.wrote(ZERO, stopped_ns)
    assert echo.obeyed(ZERO, stopped_ns + 20 * MS) == stopped_ns


def test_a_board_without_a_watchdog_obeys_zeros_by_a_stop_alone() -> None:
    echo = moved(0)
    echo.wrote(ZERO, 60 * S)
    assert echo.obeyed(ZERO, 61 * S) == 60 * S


def test_an_echo_of_an_older_stop_proves_that_one() -> None:
    """Motion, a stop, motion, a stop: all of it is still on its way back."""
    echo = Echo(0)
    for at, speeds in enumerate((FORWARD, ZERO, FORWARD, ZERO), 1):
        echo.wrote(speeds, at * S)
    assert [echo.obeyed(speeds, (5 + at) * S) for at, speeds in enumerate((FORWARD, ZERO, FORWARD, ZERO))] == [
        *(0, 2 * S, 0, 4 * S)
    ]


def test_a_stop_of_another_process_counts_as_one() -> None:
    """The port owner is dead, and what it keeps ends with motion."""
    echo = moved()
    written_ns = 1_400 * MS
    assert echo.obeyed(ZERO, 1_430 * MS, (written_ns, written_ns + 3 * MS, 500 * MS)) == written_ns + 3 * MS
    echo = moved()
    echo.wrote(ZERO, 1_650 * MS)
    assert echo.obeyed(ZERO, 1_690 * MS, (written_ns,)) == written_ns, "it may be the older one that it obeys"
