"""The gate beside a supervisor that raises epochs: which cause it latches, and which requests came before a stop."""

from __future__ import annotations

import pytest

from failstop.procs.gate import main
from failstop.shm import records
from tests.why import said

from .gate_scene import Scene
from .stage import MS


def test_the_first_cause_since_the_reset_is_latched(gate_scene: Scene) -> None:
    assert gate_scene.tick() is None
    gate_scene.stop(2, 2, "key1", "key1")
    assert gate_scene.tick() == "key1"
    gate_scene.stop(3, 2, "key1", "device lost")
    assert gate_scene.tick() == "key1"


def test_a_stop_that_crosses_the_reset_is_latched_with_its_own_cause(gate_scene: Scene) -> None:
    """The supervisor raises the epoch before it sees the reset, and the gate resets before it sees that epoch."""
    gate_scene.stop(2, 2, "key1", "key1")
    gate_scene.tick()
    gate_scene.stop(3, 2, "key1", "device lost")
    gate_scene.reset()
    assert gate_scene.gate.core.latch is None
    assert gate_scene.tick() == "device lost"
    gate_scene.stop(4, 3, "device lost", "gate died")
    assert gate_scene.tick() == "device lost"
    gate_scene.start_gate()
    assert said(gate_scene.gate.core.latch) == "device lost"


def test_a_successor_finds_what_crossed_the_reset(gate_scene: Scene) -> None:
    gate_scene.stop(2, 2, "key1", "key1")
    gate_scene.tick()
    gate_scene.stop(3, 2, "key1", "gate died")
    gate_scene.reset()
    gate_scene.start_gate()
    assert said(gate_scene.gate.core.latch) == "gate died"


def test_a_successor_finds_both_causes_together(gate_scene: Scene) -> None:
    gate_scene.stop(3, 2, "key1", "gate died")
    gate_scene.start_gate()
    assert said(gate_scene.gate.core.latch) == "key1"


def test_a_damaged_or_missing_cause_latches_too(gate_scene: Scene) -> None:
    gate_scene.raise_epoch(2)
    assert gate_scene.tick() == "stopped by the supervisor"
    gate_scene.cause.write(b"short")
    gate_scene.raise_epoch(3)
    gate_scene.start_gate()
    assert said(gate_scene.gate.core.latch) == "stopped by the supervisor"


@pytest.mark.parametrize("successor", [False, True])
@pytest.mark.parametrize(("after_ns", "granted"), [(-MS, False), (MS, True)])
def test_who_asked_before_the_stop_did_not_know_of_it(
    gate_scene: Scene, successor: bool, after_ns: int, granted: bool
) -> None:
    """Of a gate that saw the stop, and of one that was started for it."""
    gate_scene.stop(2, 2, "gate died", "gate died")
    stopped_ns = gate_scene.clock()
    if successor:
        gate_scene.start_gate()
    assert gate_scene.tick() == "gate died"
    gate_scene.request(records.RESET, stopped_ns + after_ns)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        latched = gate_scene.tick()
    done, text = gate_scene.answer()
    assert done == granted
    assert latched == (None if granted else "gate died")
    assert granted or text.startswith("asked before the last stop (gate died)")


def test_nothing_was_stopped_yet_for_the_first_gate(gate_scene: Scene) -> None:
    gate_scene.request(records.RESET, 1)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        gate_scene.tick()
    assert gate_scene.answer() == (True, "no e-stop is latched")
