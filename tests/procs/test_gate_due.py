"""When the gate has to look again although nothing is new: at the moment when what drives stops counting."""

from __future__ import annotations

from .gate_bench import MS, T0, Gate

TIMEOUT = 300 * MS
SCAN = 500 * MS


def due_ns(gate: Gate) -> int | None:
    return gate.core.due_ns(gate.now)


def scanned(*, manual: bool = False) -> Gate:
    """Commanded now, and the obstacle sensor's last delivery counts for 100 ms more."""
    gate = Gate(scan__gate="on")
    gate.enable()
    gate.core.scan.deliver(T0 - SCAN + 100 * MS, T0)
    assert gate.command(0.1, manual=manual) == ""
    return gate


def test_nothing_is_due_without_a_command(gate: Gate) -> None:
    gate.enable()
    assert due_ns(gate) is None


def test_nothing_is_due_while_disabled(gate: Gate) -> None:
    assert gate.command(0.1) == ""
    assert due_ns(gate) is None


def test_a_command_is_due_at_its_timeout_and_the_wheels_stop_in_that_step(gate: Gate) -> None:
    gate.enable()
    assert gate.command(0.1) == ""
    assert gate.step() is not None
    assert due_ns(gate) == T0 + TIMEOUT + 1
    assert gate.core.blocked(T0 + TIMEOUT) == ""
    assert gate.step(TIMEOUT + 1 - 20 * MS) == (0.0, 0.0, 0.0, 0.0)
    assert gate.blocked == "cmd timeout"
    assert due_ns(gate) is None, "or the loop would spin"


def test_the_sensor_is_due_when_it_comes_first() -> None:
    gate = scanned()
    assert due_ns(gate) == T0 + 100 * MS + 1
    gate.now += 100 * MS
    assert gate.blocked == ""
    gate.now += 1
    assert gate.blocked == "no scan"
    assert due_ns(gate) is None


def test_the_sensor_is_not_waited_for_where_it_does_not_count() -> None:
    assert due_ns(scanned(manual=True)) == T0 + TIMEOUT + 1
