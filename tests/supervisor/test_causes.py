"""The first cause since the last reset is the one that people are told."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.supervisor.causes import Causes
from failstop.supervisor.stops import Stop
from tests.why import said, why

MS = 1_000_000


def stop(text: str, t_ns: int = 100) -> Stop:
    return Stop(t_ns, "port_owner", why(text))


def reasons(pair: tuple[Stop, Stop]) -> tuple[str, str]:
    """Of (the standing one, the newest)."""
    return said(pair[0].cause), said(pair[1].cause)


def test_the_first_stands() -> None:
    causes = Causes()
    assert said(causes.add([stop("key1")], 2, 0)[0].cause) == "key1"
    assert said(causes.add([stop("gate died", 50)], 3, 0)[0].cause) == "key1", (
        "even when a later one was noticed sooner"
    )
    assert said(causes.add([stop("device lost")], 4, 0)[0].cause) == "key1"


def test_of_those_that_come_together_the_one_noticed_first() -> None:
    news = [stop("supervisor's", 300), stop("port owner's", 100), stop("gate's", 200)]
    assert said(Causes().add(news, 2, 0)[0].cause) == "port owner's"


def test_after_a_reset_the_next_stands() -> None:
    causes = Causes()
    causes.add([stop("key1")], 2, 0)
    assert said(causes.add([stop("gate died")], 3, 2)[0].cause) == "gate died"
    assert said(causes.add([stop("device lost")], 4, 2)[0].cause) == "gate died", (
        "that reset was before the one that stands"
    )
    assert said(causes.add([stop("key1")], 5, 4)[0].cause) == "key1"


def test_a_reset_of_an_older_epoch_ends_nothing() -> None:
    causes = Causes()
    causes.add([stop("key1")], 5, 0)
    assert said(causes.add([stop("gate died")], 6, 4)[0].cause) == "key1"


def test_a_cause_s_own_data_are_kept() -> None:
    first = Stop(7, "gate", why("trip"), 9)
    standing, _ = Causes().add([first], 2, 0)
    assert (standing.t_ns, standing.noticed_by, said(standing.cause), standing.written_ns) == (7, "gate", "trip", 9)
    assert Stop(7, "gate", why("trip")).written_ns == 0


def test_a_reset_that_is_seen_late_leaves_what_came_after_it() -> None:
    """The reset was made in epoch 2; epoch 3 was raised before it was seen."""
    causes = Causes()
    causes.add([stop("key1")], 2, 0)
    assert reasons(causes.add([stop("gate died")], 3, 0)) == ("key1", "gate died")
    assert causes.since == 2, "whoever has seen the reset knows by this that key1 stands no more"
    causes.settle(2)
    assert causes.standing is causes.newest
    assert causes.since == 3
    assert reasons(causes.add([stop("device lost")], 4, 2)) == ("gate died", "device lost")


@pytest.mark.parametrize(
    ("reset_epoch", "standing"), [(0, "key1"), (1, "key1"), (2, "gate died"), (3, None), (9, None)]
)
def test_what_stands_after_a_reset(reset_epoch: int, standing: str | None) -> None:
    causes = Causes()
    causes.add([stop("key1")], 2, 0)
    causes.add([stop("gate died")], 3, 0)
    for _ in range(2):
        causes.settle(reset_epoch)
        assert (causes.standing and said(causes.standing.cause)) == standing
    assert said(causes.add([stop("device lost")], 10, reset_epoch)[0].cause) == (standing or "device lost")


@given(st.lists(st.tuples(st.booleans(), st.lists(st.integers(0, 1000), min_size=1, max_size=4)), max_size=20))
def test_any_history(history: list[tuple[bool, list[int]]]) -> None:
    """Each step: was there a reset in the epoch before, and the times of the causes that come together."""
    causes = Causes()
    reset_epoch = 0
    expected = ""
    for epoch, (reset, times) in enumerate(history, start=2):
        news = [Stop(t_ns, "gate", why(f"{epoch}:{t_ns}")) for t_ns in times]
        if reset and epoch > 2:
            reset_epoch = epoch - 1
            expected = ""
        expected = expected or f"{epoch}:{min(times)}"
        assert said(causes.add(news, epoch, reset_epoch)[0].cause) == expected
