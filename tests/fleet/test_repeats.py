"""When a stop of the fleet is sent again."""

from __future__ import annotations

import pytest

from failstop.fleet.repeats import AGAIN_S, LATEST_S, MANY, MANY_AGAIN_S, Repeats


def sent(missing: int) -> Repeats:
    repeats = Repeats()
    repeats.sent(10.0, missing)
    return repeats


def test_a_stop_is_due_before_it_was_ever_sent() -> None:
    assert Repeats().due(0.0)


@pytest.mark.parametrize(("missing", "after_s"), [(1, AGAIN_S), (MANY, AGAIN_S), (MANY + 1, MANY_AGAIN_S)])
def test_a_silent_fleet_is_asked_again(missing: int, after_s: float) -> None:
    repeats = sent(missing)
    assert not repeats.due(10.0 + after_s - 0.01)
    assert repeats.due(10.0 + after_s)


def test_few_robots_are_asked_again_though_others_answer() -> None:
    repeats = sent(MANY)
    repeats.heard(10.4)
    assert repeats.due(10.0 + AGAIN_S)


def test_a_large_fleet_is_not_asked_again_while_its_answers_come_in() -> None:
    repeats = sent(MANY + 1)
    repeats.heard(10.2)
    assert repeats.due(10.0 + MANY_AGAIN_S), "a first answer makes nothing later"
    for tenth in range(44):
        repeats.heard(10.0 + tenth / 10)
        assert not repeats.due(10.0 + tenth / 10)
    repeats.heard(10.0 + LATEST_S - 0.1)
    assert repeats.due(10.0 + LATEST_S), "but for so long at most"


def test_a_large_fleet_is_asked_again_when_its_answers_end() -> None:
    repeats = sent(MANY + 1)
    repeats.heard(12.0)
    assert not repeats.due(12.0 + AGAIN_S - 0.01)
    assert repeats.due(12.0 + AGAIN_S)
