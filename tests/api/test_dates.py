"""Times of day after the wall clock was set, or after the computer has slept."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.api import verdict
from failstop.api.dates import Now, date, dated
from failstop.api.events import Event
from failstop.api.why import explain
from tests.support.states import NOW_S, STILL, state, stop

S = 10**9
NOW_NS = 1000 * S
HOURS_S = 8 * 3600.0
DECADES_S = 50 * 365 * 86400.0


@pytest.mark.parametrize(
    ("t", "slept_s", "found"),
    [
        (NOW_S - 60, 0.0, NOW_S - 60),
        (NOW_S - 62, 0.0, NOW_S - 62),
        (NOW_S - DECADES_S, 0.0, NOW_S - 60),
        (NOW_S + HOURS_S, 0.0, NOW_S - 60),
        (NOW_S - 60 - HOURS_S, HOURS_S, NOW_S - 60 - HOURS_S),
        (NOW_S - DECADES_S, HOURS_S, NOW_S - 60),
        (NOW_S + HOURS_S, HOURS_S, NOW_S - 60),
    ],
    ids=["not set", "drift", "set forward", "set back", "slept", "slept and set forward", "slept and set back"],
)
def test_when_something_of_a_minute_ago_happened(t: float, slept_s: float, found: float) -> None:
    assert date(t, NOW_NS - 60 * S, Now(NOW_S, NOW_NS, slept_s)) == found


@pytest.mark.parametrize("off_s", [-DECADES_S, HOURS_S], ids=["set forward", "set back"])
def test_a_clock_that_was_set_changes_nothing_in_the_answer(off_s: float) -> None:
    halt = stop(t=NOW_S - 12, noticed_ns=NOW_NS - 12 * S)
    gone = Event(1, NOW_S - 6, NOW_NS - 6 * S, "driver_gone", "warning", "motion disabled: nav (pid 42) died", {})
    wrong = dataclasses.replace(halt, t=halt.t + off_s), dataclasses.replace(gone, t=gone.t + off_s)
    at = Now(NOW_S, NOW_NS)
    for events in ([], [1]):
        right = explain(state(last_stop=halt), [gone for _ in events], NOW_S)
        assert explain(*dated(state(last_stop=wrong[0]), [wrong[1] for _ in events], at), NOW_S) == right


def test_wheels_that_were_seen_still_before_the_stop_are_not_seen_still_since() -> None:
    """Though the clock was set since the stop."""
    turning = dataclasses.replace(STILL, by="wheels", age_s=20.0)
    seen = state(last_stop=stop(t=NOW_S - DECADES_S, noticed_ns=NOW_NS - 12 * S), turning=turning)
    assert verdict.seen_since(seen, (), NOW_S).turning.does == "still", "by the wall clock alone"
    assert verdict.seen_since(*dated(seen, (), Now(NOW_S, NOW_NS)), NOW_S).turning.does == "unknown"
