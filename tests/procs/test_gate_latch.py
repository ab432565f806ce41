"""The latch: the first reason stays until a reset, which clears it and nothing else."""

from __future__ import annotations

import pytest

from failstop.procs.gate.core import REST
from tests.support.why import said, told, why

from .gate_bench import Gate, stands


def test_a_trip_stands_disables_and_latches_at_once(driving: Gate) -> None:
    assert driving.core.stop(why("key1"), 3)
    assert stands(driving)
    assert not driving.core.enabled
    assert driving.blocked == "estop: key1"
    assert driving.step() is None


def test_the_first_reason_is_kept(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    assert not driving.core.stop(why("another"), 4)
    assert said(driving.core.latch) == "key1"


def test_a_reason_without_words_latches_too(driving: Gate) -> None:
    assert driving.core.stop(why(""), 1)
    assert driving.blocked == "estop: stop request"
    assert told(driving.core.enable(2, "", driving.now)) == (False, "a stop is latched (stop request)")


def test_the_latch_is_told_before_everything_else(gate: Gate) -> None:
    gate.core.stop(why("key1"), 1)
    assert gate.blocked == "estop: key1"
    gate.core.follow(None, 2)
    assert gate.blocked == "disabled"
    gate.enable()
    assert gate.blocked == "cmd timeout"
    gate.take(REST)
    assert gate.blocked == ""


def test_enable_is_refused_while_latched(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    assert told(driving.core.enable(4, "", driving.now)) == (False, "a stop is latched (key1)")
    assert not driving.core.enabled


def test_nothing_but_a_reset_ends_a_latch(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    driving.core.disable()
    driving.gone(1)
    driving.core.enable(4, "", driving.now)
    driving.take((0.2, 0.0, 0.0))
    for _ in range(100):
        driving.step()
    assert driving.blocked == "estop: key1"


def test_the_end_of_the_latch_enables_nothing(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    driving.core.follow(None, 4)
    assert driving.core.latch is None
    assert driving.blocked == "disabled"
    driving.take((0.2, 0.0, 0.0))
    assert driving.step() is None
    assert stands(driving)


def test_its_own_trip_holds_until_the_supervisor_has_answered_it(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    driving.core.follow(None, 3)
    assert driving.blocked == "estop: key1"
    driving.core.follow(None, 4)
    assert driving.blocked == "disabled"


def test_what_the_supervisor_has_latched_is_what_counts(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    driving.core.follow(why("gate died"), 3)
    assert driving.blocked == "estop: gate died"


def test_what_the_supervisor_has_latched_ends_by_its_word_in_the_first_epoch_too(gate: Gate) -> None:
    gate.core.follow(why("gate died"), 1)
    gate.core.follow(None, 1)
    assert gate.blocked == "disabled"


def test_what_the_supervisor_has_latched_stands_at_once(driving: Gate) -> None:
    driving.core.follow(why("gate died"), 1)
    assert stands(driving)
    assert not driving.core.enabled


def test_nothing_latched_is_no_news_for_who_drives(driving: Gate) -> None:
    driving.core.follow(None, 1)
    assert driving.core.enabled
    assert driving.core.velocity == (0.2, 0.0, 0.0)


def test_after_reset_and_enable_the_ramp_starts_from_zero(driving: Gate) -> None:
    driving.core.stop(why("key1"), 3)
    driving.core.follow(None, 4)
    driving.enable(4)
    assert driving.core.epoch == 4
    assert driving.drive((0.2, 0.0, 0.0), 1)[0][0] == pytest.approx(0.01)
