"""The gate is disabled until it is enabled, and any sequence of events keeps all of its rules (gate_machine.py)."""

from __future__ import annotations

import pytest

from tests.support.why import told

from .gate_bench import Gate, stands
from .gate_machine import GateMachine

test_any_sequence_keeps_the_rules = pytest.mark.slow(GateMachine.TestCase)


def test_a_gate_starts_disabled(gate: Gate) -> None:
    assert gate.blocked == "disabled"
    assert gate.core.latch is None


def test_commands_move_nothing_while_disabled(gate: Gate) -> None:
    for _ in range(20):
        assert gate.take((0.2, 0.0, 0.0)) == ""
        assert gate.step() is None
    assert stands(gate)


def test_an_enable_takes_the_epoch(gate: Gate) -> None:
    gate.enable(epoch=7)
    assert gate.core.enabled
    assert gate.core.epoch == 7


def test_an_enable_is_refused_while_something_is_missing(gate: Gate) -> None:
    assert told(gate.core.enable(1, "the port", gate.now)) == (False, "not ready: the port")
    assert gate.blocked == "disabled"


def test_an_enable_while_enabled_changes_nothing(driving: Gate) -> None:
    assert told(driving.core.enable(9, "", driving.now)) == (True, "motion enabled")
    assert driving.core.epoch == 1
    assert driving.core.velocity == (0.2, 0.0, 0.0)


def test_a_command_from_before_the_enable_does_not_move(gate: Gate) -> None:
    gate.take((0.2, 0.0, 0.0))
    gate.enable()
    assert gate.blocked == "cmd timeout"
    gate.step()
    assert stands(gate)


def test_a_disable_stops_the_wheels_at_once(driving: Gate) -> None:
    assert told(driving.core.disable()) == (True, "motion disabled")
    assert driving.blocked == "disabled"
    assert stands(driving)
    assert driving.step() is None
