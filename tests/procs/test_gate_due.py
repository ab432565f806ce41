"""When the gate has to look again although nothing is new: at the moment when what drives stops counting."""

from __future__ import annotations

from failstop.policy.kinematics import mecanum
from failstop.policy.settings import Settings
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.sources import Command

MS = 1_000_000
T0 = 100_000 * MS
TIMEOUT = 300 * MS
SCAN = 500 * MS


def gate(*, scan_gate: str = "off", enabled: bool = True) -> GateCore:
    core = GateCore(Settings({"scan.gate": scan_gate}), mecanum(0.08, 0.17706, 0.17165), T0)
    if enabled:
        assert core.enable(1, "", T0).done
    return core


def command(core: GateCore, t_ns: int, *, manual: bool = False) -> None:
    assert core.take(Command(1, "test", t_ns, (0.1, 0.0, 0.0), manual=manual), t_ns) is None


def test_without_a_command_nothing_is_due() -> None:
    assert gate().due_ns(T0) is None


def test_while_disabled_nothing_is_due() -> None:
    core = gate(enabled=False)
    command(core, T0)
    assert core.due_ns(T0) is None


def test_a_command_is_due_at_its_timeout_and_the_wheels_stop_in_that_step() -> None:
    core = gate()
    command(core, T0)
    assert core.step(T0 + 20 * MS) is not None
    due_ns = core.due_ns(T0 + 20 * MS)
    assert due_ns == T0 + TIMEOUT + 1
    assert core.blocked(due_ns - 1) == ""
    assert core.blocked(due_ns) == "cmd timeout"
    assert core.step(due_ns) == (0.0, 0.0, 0.0, 0.0)
    assert core.due_ns(due_ns) is None, "or the loop would spin"


def test_the_sensor_is_due_when_it_comes_first() -> None:
    core = gate(scan_gate="on")
    core.scan.deliver(T0 - SCAN + 100 * MS, T0)
    command(core, T0)
    due_ns = core.due_ns(T0)
    assert due_ns == T0 + 100 * MS + 1
    assert core.blocked(due_ns - 1) == ""
    assert core.blocked(due_ns) == "no scan"
    assert core.due_ns(due_ns) is None


def test_the_sensor_is_not_waited_for_where_it_does_not_count() -> None:
    core = gate(scan_gate="on")
    core.scan.deliver(T0 - SCAN + 100 * MS, T0)
    command(core, T0, manual=True)
    assert core.due_ns(T0) == T0 + TIMEOUT + 1
