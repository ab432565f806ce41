"""The restart policy: at once, then ever later, then not at all."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.supervisor.children import LONGEST_WAIT_NS, Restarts

MS = 1_000_000
S = 1_000 * MS
T0 = 777 * S
BACKOFF = 100 * MS


def waits(restarts: Restarts, *times_s: float) -> list[int | None]:
    return [restarts.died(T0 + round(t * S)) for t in times_s]


@pytest.fixture
def restarts() -> Restarts:
    return Restarts(5, 60 * S, BACKOFF)


def test_the_first_at_once_then_doubling_then_not_at_all(restarts: Restarts) -> None:
    assert waits(restarts, 0, 1, 2, 3, 4) == [0, BACKOFF, 2 * BACKOFF, 4 * BACKOFF, None]


def test_it_stays_down(restarts: Restarts) -> None:
    waits(restarts, 0, 1, 2, 3, 4)
    assert waits(restarts, 5, 59) == [None, None]


def test_deaths_beyond_the_window_are_forgotten(restarts: Restarts) -> None:
    assert waits(restarts, 0, 1, 2, 3) == [0, BACKOFF, 2 * BACKOFF, 4 * BACKOFF]
    assert waits(restarts, 61.5) == [2 * BACKOFF], "with two of the four"
    assert waits(restarts, 200) == [0]


def test_the_window_ends_exactly_then(restarts: Restarts) -> None:
    assert restarts.died(T0) == 0
    assert restarts.died(T0 + 60 * S - 1) == BACKOFF
    restarts = Restarts(5, 60 * S, BACKOFF)
    assert restarts.died(T0) == 0
    assert restarts.died(T0 + 60 * S) == 0


def test_one_death_now_and_then_never_counts_up(restarts: Restarts) -> None:
    assert waits(restarts, *range(0, 6_000, 61)) == [0] * 99


def test_five_in_sixty_seconds_but_not_five_in_sixty_one(restarts: Restarts) -> None:
    assert waits(restarts, 0, 15, 30, 45, 60)[-1] is not None
    assert waits(restarts, 60.5)[-1] is None


def test_waits_have_a_longest() -> None:
    restarts = Restarts(100, 60 * S, BACKOFF)
    found = waits(restarts, *(n / 100 for n in range(99)))
    assert max(wait for wait in found if wait is not None) == LONGEST_WAIT_NS
    assert found[-1] == LONGEST_WAIT_NS


def test_a_limit_of_one_never_restarts() -> None:
    assert waits(Restarts(1, 60 * S, BACKOFF), 0, 1000) == [None, None]


def test_processes_are_counted_each_for_itself() -> None:
    one, other = Restarts(2, 60 * S, BACKOFF), Restarts(2, 60 * S, BACKOFF)
    assert waits(one, 0, 1) == [0, None]
    assert waits(other, 2) == [0]


@given(
    limit=st.integers(1, 10),
    backoff=st.integers(1, 10 * S),
    gaps=st.lists(st.integers(0, 90 * S), max_size=40),
)
def test_a_restart_is_refused_when_and_only_when_the_window_is_full(limit: int, backoff: int, gaps: list[int]) -> None:
    restarts = Restarts(limit, 60 * S, backoff)
    deaths: list[int] = []
    now = T0
    for gap in gaps:
        now += gap
        deaths.append(now)
        within = sum(now - death < 60 * S for death in deaths)
        wait = restarts.died(now)
        assert (wait is None) == (within >= limit)
        if wait is not None:
            assert 0 <= wait <= LONGEST_WAIT_NS
            assert (wait == 0) == (within == 1)
