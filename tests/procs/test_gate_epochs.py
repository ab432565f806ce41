"""The gate beside a supervisor that raises epochs: which cause it latches, and which requests came before a stop."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from failstop.messages import layout, records
from failstop.procs.gate import main
from failstop.procs.gate.requests import UNSEEN
from failstop.supervisor.stops import Stop
from tests.support.gate_scene import Scene
from tests.support.stage import MS
from tests.support.why import why


@pytest.mark.claim("CAUSE-1")
def test_the_first_cause_since_the_reset_is_latched(scene: Scene) -> None:
    assert scene.tick() is None
    assert scene.stop_and_tick("key1") == "key1"
    assert scene.stop_and_tick("device lost") == "key1"


def test_a_stop_that_comes_with_the_decision_of_a_reset_is_latched_at_once(scene: Scene) -> None:
    """The gate looks at the latch for the reset before it has seen the epoch of a stop that came after it."""
    scene.stop_and_tick("key1")
    scene.ask(records.RESET)
    assert scene.ask(records.ENABLE)[0]
    scene.latch.add([Stop(scene.clock(), layout.SUPERVISOR, why("device lost"))], 3, scene.clock())
    scene.ask(records.RESET, scene.clock() - 1)
    assert scene.latched() == "device lost"
    assert not scene.gate.core.enabled


def test_a_reset_whose_person_had_not_seen_the_newest_stop_is_refused(scene: Scene) -> None:
    """The reset was asked for after that one."""
    scene.stop_and_tick("key1")
    scene.saw(2)
    scene.stop_and_tick("key2")
    assert scene.ask(records.RESET) == (False, UNSEEN)
    assert scene.latched() == "key1"
    scene.saw(3)
    assert scene.ask(records.RESET)[0]
    assert scene.latched() is None
    scene.stop_and_tick("key1")
    scene.saw(0)
    assert scene.ask(records.RESET)[0], "one that names no stop is of who asks alone"


def test_a_stop_counts_as_newer_before_the_gate_itself_has_followed_it(scene: Scene) -> None:
    scene.stop_and_tick("key1")
    scene.ask(records.DISABLE)
    scene.saw(2)
    slot = scene.gate.clients.slots[0]
    scene.stop("key2")
    scene.gate.take_request(scene.clock(), slot, scene.clock(), 2, records.RESET)
    scene.gate.requests.write()
    assert scene.replied()[1:] == (False, UNSEEN)
    assert scene.tick() == "key1"


@pytest.mark.claim("MOVE-2")
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 2)), max_size=12))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_reset_clears_a_stop_that_its_person_had_not_seen(scene: Scene, steps: list[tuple[bool, int, int]]) -> None:
    epoch = scene.gate.epoch
    for stops, behind, ago in steps:
        scene.clock.now_ns += MS
        if stops:
            epoch += 1
            scene.stop(f"key{1 + epoch % 2}")
            scene.tick()
            continue
        was, seen = scene.latched(), max(0, epoch - behind)
        scene.saw(seen)
        done, _ = scene.ask(records.RESET, scene.clock() - ago)
        if done and was:
            assert seen in (0, epoch)
            assert scene.latched() is None
        elif seen not in (0, epoch):
            assert not done
            assert scene.latched() == was


@pytest.mark.parametrize("resets", [0, 1])
def test_a_successor_finds_what_is_latched(scene: Scene, resets: int) -> None:
    scene.stop("key1")
    scene.stop_and_tick("gate died")
    for _ in range(resets):
        scene.ask(records.RESET)
    scene.start_gate()
    assert scene.latched() == (None if resets else "key1")
    assert not scene.gate.core.enabled


def test_a_reset_that_its_predecessor_asked_for_is_nobody_s(scene: Scene) -> None:
    scene.stop_and_tick("key1")
    scene.gate.take_request(0, scene.gate.clients.slots[0], scene.clock(), 1, records.RESET)
    scene.start_gate()
    scene.decide()
    assert scene.tick() is None, "but it is one all the same"
    assert scene.replied() == (0, records.UNDER_WAY, "")


def test_a_client_that_asks_for_resets_without_end_is_in_the_line_once(scene: Scene) -> None:
    """They are decided one after the other, and nobody else has to wait behind the rest of its."""
    mine, other = scene.gate.clients.slots[:2]
    scene.stop_and_tick("key1")
    for number in range(1000):
        scene.gate.take_request(scene.clock(), mine, scene.clock(), number, records.RESET)
    scene.gate.take_request(scene.clock(), other, scene.clock(), 1, records.RESET)
    assert scene.own.word("resets_asked").get() == 1
    scene.decide()
    assert scene.own.word("resets_asked").get() == 3
    assert scene.replied() == (999, True, "no stop is latched")
    assert scene.own.latest_reader("reply.1").read()


def test_a_damaged_cause_latches_too(scene: Scene) -> None:
    record = records.LATCH.pack(2, scene.clock(), scene.clock(), b"?")
    scene.views[layout.SUPERVISOR].latest_writer("latch").write(record, scene.clock())
    scene.raise_epoch(2)
    assert scene.tick() == "stopped by the supervisor"


@pytest.mark.parametrize("successor", [False, True])
@pytest.mark.parametrize(("after_ns", "granted"), [(-MS, False), (MS, True)])
def test_a_request_of_before_the_stop_did_not_know_of_it(
    scene: Scene, successor: bool, after_ns: int, granted: bool
) -> None:
    """It holds for a gate that saw the stop, and for one that was started for it."""
    scene.stop("gate died")
    stopped_ns = scene.clock()
    if successor:
        scene.start_gate()
    assert scene.tick() == "gate died"
    if not granted:
        assert scene.ask(records.ENABLE, stopped_ns + after_ns)[1].startswith("asked before the last stop (gate died)")
    scene.ask_for(records.RESET, asked_ns=stopped_ns + after_ns)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        latched = scene.tick()
    done, text = scene.answered()
    assert done == granted
    assert latched == (None if granted else "gate died")
    assert granted or text.startswith("asked before the last stop (gate died)")
    assert scene.ask(records.RESET)[0], "and now it does"


def test_nothing_was_stopped_yet_for_the_first_gate(scene: Scene) -> None:
    scene.ask_for(records.RESET, asked_ns=scene.clock() - MS)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        scene.tick()
    assert scene.answered() == (True, "no stop is latched")
