"""The gate beside a supervisor that raises epochs: which cause it latches, and which requests came before a stop."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from failstop.procs.gate import main
from failstop.procs.gate.requests import UNSEEN
from failstop.shm import layout, records
from failstop.supervisor.stops import Stop
from tests.support.gate_scene import Scene
from tests.support.stage import MS
from tests.support.why import why


def test_the_first_cause_since_the_reset_is_latched(gate_scene: Scene) -> None:
    assert gate_scene.tick() is None
    gate_scene.stop("key1")
    assert gate_scene.tick() == "key1"
    gate_scene.stop("device lost")
    assert gate_scene.tick() == "key1"


def test_a_stop_that_comes_with_the_decision_of_a_reset_is_latched_at_once(gate_scene: Scene) -> None:
    """The gate looks at the latch for the reset before it has seen the epoch of a stop that came after it."""
    gate_scene.stop("key1")
    gate_scene.tick()
    gate_scene.ask(records.RESET)
    assert gate_scene.ask(records.ENABLE)[0]
    gate_scene.latch.add([Stop(gate_scene.clock(), layout.SUPERVISOR, why("device lost"))], 3, gate_scene.clock())
    gate_scene.ask(records.RESET, gate_scene.clock() - 1)
    assert gate_scene.latched() == "device lost"
    assert not gate_scene.gate.core.enabled


def test_a_reset_whose_person_had_not_seen_the_newest_stop_is_refused(gate_scene: Scene) -> None:
    """Though it was asked for after that one."""
    gate_scene.stop("key1")
    gate_scene.tick()
    gate_scene.saw(2)
    gate_scene.stop("key2")
    gate_scene.tick()
    assert gate_scene.ask(records.RESET) == (False, UNSEEN)
    assert gate_scene.latched() == "key1"
    gate_scene.saw(3)
    assert gate_scene.ask(records.RESET)[0]
    assert gate_scene.latched() is None


def test_a_stop_counts_as_newer_before_the_gate_itself_has_followed_it(gate_scene: Scene) -> None:
    gate_scene.stop("key1")
    gate_scene.tick()
    gate_scene.ask(records.DISABLE)
    gate_scene.saw(2)
    slot = gate_scene.gate.clients.slots[0]
    gate_scene.stop("key2")
    gate_scene.gate.requests.take(slot, 2, records.RESET, gate_scene.clock(), gate_scene.clock())
    assert gate_scene.replied()[1:] == (False, UNSEEN)
    assert gate_scene.tick() == "key1"


def test_a_reset_that_names_no_stop_is_of_whom_it_was_asked_by_alone(gate_scene: Scene) -> None:
    gate_scene.stop("key1")
    gate_scene.stop("key2")
    gate_scene.tick()
    gate_scene.saw(0)
    assert gate_scene.ask(records.RESET)[0]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 2)), max_size=12))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_reset_clears_a_stop_that_its_person_had_not_seen(
    gate_scene: Scene, steps: list[tuple[bool, int, int]]
) -> None:
    epoch = gate_scene.gate.epoch
    for stops, behind, ago in steps:
        gate_scene.clock.now_ns += MS
        if stops:
            epoch += 1
            gate_scene.stop(f"key{1 + epoch % 2}")
            gate_scene.tick()
            continue
        was, seen = gate_scene.latched(), max(0, epoch - behind)
        gate_scene.saw(seen)
        done, _ = gate_scene.ask(records.RESET, gate_scene.clock() - ago)
        if done and was:
            assert seen in (0, epoch)
            assert gate_scene.latched() is None
        elif seen not in (0, epoch):
            assert not done
            assert gate_scene.latched() == was


@pytest.mark.parametrize("resets", [0, 1])
def test_a_successor_finds_what_is_latched(gate_scene: Scene, resets: int) -> None:
    gate_scene.stop("key1")
    gate_scene.stop("gate died")
    gate_scene.tick()
    for _ in range(resets):
        gate_scene.ask(records.RESET)
    gate_scene.start_gate()
    assert gate_scene.latched() == (None if resets else "key1")
    assert not gate_scene.gate.core.enabled


def test_a_reset_that_its_predecessor_asked_for_is_nobody_s(gate_scene: Scene) -> None:
    gate_scene.stop("key1")
    gate_scene.tick()
    gate_scene.gate.requests.take(gate_scene.gate.clients.slots[0], 1, records.RESET, gate_scene.clock(), 0)
    gate_scene.start_gate()
    gate_scene.decide()
    assert gate_scene.tick() is None, "but it is one all the same"
    assert gate_scene.replied() == (0, records.UNDER_WAY, "")


def test_resets_are_decided_one_after_the_other(gate_scene: Scene) -> None:
    slot = gate_scene.gate.clients.slots[0]
    gate_scene.stop("key1")
    gate_scene.tick()
    for number in (7, 8):
        gate_scene.gate.requests.take(slot, number, records.RESET, gate_scene.clock(), gate_scene.clock())
    assert gate_scene.own.word("resets_asked").get() == 1
    gate_scene.decide()
    assert gate_scene.own.word("resets_asked").get() == 2
    assert gate_scene.replied() == (8, True, "no stop is latched")


def test_who_asks_for_resets_without_end_is_in_the_line_once(gate_scene: Scene) -> None:
    """While the first one is being decided; nobody else has to wait behind the rest."""
    mine, other = gate_scene.gate.clients.slots[:2]
    gate_scene.stop("key1")
    gate_scene.tick()
    for number in range(1000):
        gate_scene.gate.requests.take(mine, number, records.RESET, gate_scene.clock(), gate_scene.clock())
    gate_scene.gate.requests.take(other, 1, records.RESET, gate_scene.clock(), gate_scene.clock())
    gate_scene.decide()
    assert gate_scene.own.word("resets_asked").get() == 3
    assert gate_scene.replied() == (999, True, "no stop is latched")
    assert gate_scene.own.latest_reader("reply.1").read()


def test_a_damaged_cause_latches_too(gate_scene: Scene) -> None:
    record = records.LATCH.pack(2, gate_scene.clock(), gate_scene.clock(), b"?")
    gate_scene.views[layout.SUPERVISOR].latest_writer("latch").write(record, gate_scene.clock())
    gate_scene.raise_epoch(2)
    assert gate_scene.tick() == "stopped by the supervisor"


@pytest.mark.parametrize("successor", [False, True])
@pytest.mark.parametrize(("after_ns", "granted"), [(-MS, False), (MS, True)])
def test_who_asked_before_the_stop_did_not_know_of_it(
    gate_scene: Scene, successor: bool, after_ns: int, granted: bool
) -> None:
    """Of a gate that saw the stop, and of one that was started for it."""
    gate_scene.stop("gate died")
    stopped_ns = gate_scene.clock()
    if successor:
        gate_scene.start_gate()
    assert gate_scene.tick() == "gate died"
    gate_scene.ask_for(records.RESET, asked_ns=stopped_ns + after_ns)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        latched = gate_scene.tick()
    done, text = gate_scene.answered()
    assert done == granted
    assert latched == (None if granted else "gate died")
    assert granted or text.startswith("asked before the last stop (gate died)")


def test_nothing_was_stopped_yet_for_the_first_gate(gate_scene: Scene) -> None:
    gate_scene.ask_for(records.RESET, asked_ns=1)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        gate_scene.tick()
    assert gate_scene.answered() == (True, "no stop is latched")
