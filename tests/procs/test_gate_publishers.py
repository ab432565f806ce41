"""One publisher of good commands: a second one stops, a value that is not finite stops, and one that dies stands."""

from __future__ import annotations

from math import inf, nan

import pytest

from failstop.procs.gate.core import NO_SPEEDS, REST

from .gate_bench import MS, Gate


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_value_that_is_not_finite_is_a_reason_to_trip(driving: Gate, axis: int, value: float) -> None:
    wanted = [0.1, 0.1, 0.1]
    wanted[axis] = value
    before = driving.core.sources.driving(driving.now)
    assert driving.take((wanted[0], wanted[1], wanted[2])) == "command from client 1 is not finite"
    assert driving.core.sources.driving(driving.now) is before


def test_a_second_publisher_is_a_reason_with_both_names(driving: Gate) -> None:
    assert driving.take((0.1, 0.0, 0.0), session=2) == "multiple cmd_vel publishers: client 1, client 2"


def test_a_second_publisher_counts_while_disabled_too(gate: Gate) -> None:
    gate.take(REST)
    assert gate.take(REST, session=2) == "multiple cmd_vel publishers: client 1, client 2"


def test_another_may_take_over_once_the_last_command_no_longer_counts(driving: Gate) -> None:
    driving.take(REST)
    driving.step(300 * MS)
    assert driving.take(REST, session=2).startswith("multiple")
    driving.step(1)
    assert driving.take((0.1, 0.0, 0.0), session=2) == ""


def test_the_driver_s_orderly_end_stands_at_once(driving: Gate) -> None:
    driving.gone(2, parted=True)
    assert driving.blocked == "", "a client that does not drive"
    driving.gone(1, parted=True)
    assert driving.step(0) == NO_SPEEDS
    assert driving.blocked == "cmd timeout"
    assert driving.core.latch is None


def test_another_may_drive_at_once_when_the_driver_has_ended(driving: Gate) -> None:
    driving.gone(1, parted=True)
    driving.step(0)
    assert driving.take((0.2, 0.0, 0.0), session=2) == ""
    driving.step()
    assert driving.core.velocity[0] == pytest.approx(0.01), "from zero, along the ramp"
