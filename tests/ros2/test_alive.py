"""Senders of an arm's goal, alive or not as seen: the time and what DDS says are the test's."""

from __future__ import annotations

import pytest

from failstop.ros2.alive import DISCOVERY_NS, LEAST_NS, Alive, Unwatched

S = 1_000_000_000
MS = 1_000_000


def test_one_that_acknowledges_lives_for_as_long_as_it_does() -> None:
    client = Alive(0, 0.5)
    for now_ns in range(0, 60 * S, 20 * MS):
        assert client.look(1, True, now_ns) == ""


@pytest.mark.parametrize("heard", [1, 2])
def test_one_that_acknowledges_nothing_is_gone_after_the_timeout(heard: int) -> None:
    client = Alive(0, 0.5)
    assert client.look(1, True, S) == ""
    assert client.look(heard, False, S + 500 * MS - 1) == ""
    assert client.look(heard, False, S + 500 * MS) == "a node that hears of the goal has acknowledged nothing for 0.5 s"


def test_a_short_timeout_is_no_shorter_than_three_messages() -> None:
    client = Alive(0, 0.1)
    assert client.look(1, True, S) == ""
    assert client.look(1, False, S + LEAST_NS - 1) == ""
    assert client.look(1, False, S + LEAST_NS)


def test_one_that_was_met_and_hears_no_more_is_gone_at_once() -> None:
    client = Alive(0, 0.5)
    assert client.look(1, True, S) == ""
    assert client.look(0, True, S + 1) == "nobody hears of the goal any more"


def test_one_that_is_never_met_is_given_the_time_of_discovery() -> None:
    client = Alive(0, 0.5)
    assert client.look(0, True, DISCOVERY_NS - 1) == ""
    assert client.look(0, True, DISCOVERY_NS) == "nobody hears of the goal reliably", "best effort acknowledges nothing"
    client = Alive(0, 0.5)
    assert client.look(1, False, DISCOVERY_NS - 1) == ""
    assert client.look(1, False, DISCOVERY_NS)


def test_a_sender_of_the_topic() -> None:
    sender = Unwatched(0, 3.0)
    assert sender.look(1, 0) == ""
    assert sender.look(1, 3 * S) == ""
    assert sender.look(1, 3 * S + 1) == "it takes longer than 3 s (arm.unwatched_s)"
    assert sender.look(0, 1) == "its publisher has gone"
    late = Unwatched(0, 3.0)
    assert late.look(0, DISCOVERY_NS - 1) == "", "the graph may know the publisher later than its message"
    assert late.look(1, DISCOVERY_NS) == ""
    assert Unwatched(0, 3.0).look(0, DISCOVERY_NS) == "its publisher has gone"
