"""Stops that are new: never twice, never old, wherever the clock is set."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.fleet import replay
from failstop.fleet.replay import AGAIN, NEW, Seen

NOW_S = 1_000_000.0


def obeyed(seen: Seen, stop_id: str, dated_s: float, now_s: float) -> bool:
    """True where the stop is carried out."""
    if seen.judge(stop_id, dated_s, now_s) != NEW:
        return False
    seen.obeyed(stop_id, dated_s, now_s)
    return True


def test_once() -> None:
    seen = Seen(10.0)
    assert obeyed(seen, "a", NOW_S, NOW_S)
    assert seen.judge("a", NOW_S, NOW_S) == AGAIN
    assert obeyed(seen, "b", NOW_S, NOW_S), "another one of the same moment"


@pytest.mark.parametrize("off_s", [-10.0, -1.0, 0.0, 10.0])
def test_within_the_tolerance(off_s: float) -> None:
    assert Seen(10.0).judge("a", NOW_S + off_s, NOW_S) == NEW


@pytest.mark.parametrize(
    ("off_s", "words"),
    [
        (-10.1, "old by 10 s"),
        (-86400.0, "old by 24 h 0 min"),
        (-1.7e9, "old by 19676 days"),
        (45.0, "ahead by 45 s"),
        (math.inf, "ahead"),
    ],
)
def test_beyond_it(off_s: float, words: str) -> None:
    assert words in Seen(10.0).judge("a", NOW_S + off_s, NOW_S)


def test_a_date_that_is_no_number() -> None:
    assert Seen(10.0).judge("a", math.nan, NOW_S) not in (NEW, AGAIN)


def test_a_clock_that_is_set_back_makes_nothing_new_again() -> None:
    seen = Seen(10.0)
    assert obeyed(seen, "a", NOW_S, NOW_S)
    assert obeyed(seen, "b", NOW_S + 3600, NOW_S + 3600)
    assert "set back" in seen.judge("a", NOW_S, NOW_S), "`a` is forgotten by now"
    assert obeyed(seen, "c", NOW_S + 1, NOW_S), "what is newer than all that is forgotten is obeyed"


def test_over_a_restart() -> None:
    seen = Seen(10.0)
    assert obeyed(seen, "a", NOW_S, NOW_S)
    again = Seen.load(seen.dump(), 10.0)
    assert again.judge("a", NOW_S, NOW_S) == AGAIN
    assert obeyed(again, "b", NOW_S + 3600, NOW_S + 3600)
    assert "set back" in Seen.load(again.dump(), 10.0).judge("a", NOW_S, NOW_S)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"[]",
        b'{"ids": 7, "floor_s": 0}',
        b'{"ids": {"a": null}, "floor_s": 0}',
        b'{"ids": {"a": NaN}, "floor_s": 0}',
        b'{"ids": {}, "floor_s": 1e300}',
        b'{"ids": {}, "floor_s": Infinity}',
    ],
)
def test_what_is_remembered_can_be_damaged(data: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        Seen.load(data, 10.0)


def test_a_flood_of_genuine_ones_is_remembered_up_to_a_bound() -> None:
    seen = Seen(10.0)
    for number in range(replay.MOST + 50):
        assert obeyed(seen, f"{number}", NOW_S + number * 1e-3, NOW_S)
    assert len(seen.dump()) < 20_000
    for number in range(replay.MOST + 50):
        assert not obeyed(seen, f"{number}", NOW_S + number * 1e-3, NOW_S), number


step = st.tuples(st.integers(0, 12), st.floats(-40, 40), st.booleans())


@given(st.lists(step, max_size=60))
def test_no_message_is_obeyed_twice(steps: list[tuple[int, float, bool]]) -> None:
    """Each id has one date; the clock jumps to and fro, and the program is started anew now and then."""
    seen = Seen(10.0)
    now_s = NOW_S
    done: set[int] = set()
    for number, jump_s, restart in steps:
        now_s += jump_s
        if restart:
            seen = Seen.load(seen.dump(), 10.0)
        if obeyed(seen, f"{number}", NOW_S + number * 3, now_s):
            assert number not in done
            done.add(number)
