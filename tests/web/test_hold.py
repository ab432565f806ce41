"""A hold by the word of a page and the robot's clock. The times are given."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.web.hold import GAP_S, HOLD_S, SURE_S, Hold

TICK_S = 0.1


def held(begun_s: float = 10.0) -> Hold:
    return Hold("enable", "a", 7, None, begun_s, begun_s)


def kept_up(hold: Hold, seconds: float) -> tuple[bool, float]:
    """The page says ten times a second that it lasts; returns whether it was long enough, and when that was asked."""
    now_s = hold.begun_s
    for _ in range(round(seconds / TICK_S)):
        now_s += TICK_S
        assert hold.held(now_s)
        if hold.enough(now_s):
            return True, now_s
    return False, now_s


def test_a_hold_of_two_seconds_that_lasts_when_the_robot_asks_counts() -> None:
    hold = held()
    enough, now_s = kept_up(hold, HOLD_S + TICK_S)
    assert enough
    assert now_s - hold.begun_s >= HOLD_S
    assert hold.sure(now_s + 0.1)


def test_a_shorter_one_is_never_long_enough() -> None:
    assert not kept_up(held(), HOLD_S - TICK_S)[0]


def test_nobody_is_asked_twice() -> None:
    hold = held()
    _, now_s = kept_up(hold, HOLD_S + TICK_S)
    assert not hold.enough(now_s + TICK_S)


def test_a_page_that_was_not_asked_is_never_sure() -> None:
    hold = held()
    _, now_s = kept_up(hold, HOLD_S - TICK_S)
    assert not hold.sure(now_s + TICK_S)


def test_a_gap_ends_it() -> None:
    hold = held()
    assert hold.held(10.0 + GAP_S)
    assert not hold.held(10.0 + 2 * GAP_S + 0.001)


def test_an_answer_that_comes_late_counts_for_nothing() -> None:
    hold = held()
    _, now_s = kept_up(hold, HOLD_S + TICK_S)
    while now_s - (hold.enough_s or 0.0) <= SURE_S:
        now_s += TICK_S
        assert hold.held(now_s)
    assert not hold.sure(now_s)


@pytest.mark.parametrize("backlog_s", [2.0, 3.0, 60.0])
def test_what_a_network_delivers_at_once_counts_for_nothing(backlog_s: float) -> None:
    """All words of a whole hold, long after it began."""
    hold = held()
    assert not hold.held(10.0 + backlog_s)


@given(st.lists(st.tuples(st.sampled_from(["held", "sure"]), st.floats(0, 1.0)), max_size=60))
def test_nothing_counts_that_was_not_held_for_two_seconds_whatever_a_page_says(
    said: list[tuple[str, float]],
) -> None:
    hold, now_s, unbroken = held(), 10.0, True
    for word, after_s in said:
        now_s += after_s
        unbroken = unbroken and after_s <= GAP_S
        if word == "sure":
            if hold.sure(now_s):
                assert unbroken
                assert now_s - 10.0 >= HOLD_S
            return
        if not hold.held(now_s):
            return
        hold.enough(now_s)
