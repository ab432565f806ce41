"""The gate's shell, turn by turn: what it hands to the port owner and the supervisor, and whom it refuses."""

from __future__ import annotations

import pytest

from failstop.procs.gate.requests import NO_ARM
from failstop.shm import records
from tests.support.gate_scene import Scene
from tests.support.stage import MS


@pytest.mark.parametrize("verb", [records.ENABLE, records.RESET])
def test_who_asked_before_the_last_stop_did_not_know_of_it(gate_scene: Scene, verb: int) -> None:
    asked_ns = gate_scene.clock() - 1
    gate_scene.stop("key1")
    gate_scene.turn()
    done, text = gate_scene.ask(verb, asked_ns)
    assert not done
    assert text.startswith("asked before the last stop (key1)")
    assert gate_scene.latched() == "key1"
    assert gate_scene.ask(records.RESET)[0], "and now it does"


def test_an_enable_that_was_asked_for_before_a_disable_and_comes_after_it_moves_nothing(gate_scene: Scene) -> None:
    asked_ns = gate_scene.clock() - 1
    assert gate_scene.ask(records.DISABLE)[0]
    assert gate_scene.ask(records.ENABLE, asked_ns) == (False, "a later request took its place: ask again")
    assert gate_scene.ask(records.ENABLE)[0]


def test_a_disable_dated_in_the_future_keeps_nobody_from_enabling(gate_scene: Scene) -> None:
    assert gate_scene.ask(records.DISABLE, gate_scene.clock() + 10_000 * MS)[0]
    gate_scene.turn(20 * MS)
    assert gate_scene.ask(records.ENABLE)[0]


@pytest.mark.parametrize(("verb", "why"), [(records.ARM_TUCK, NO_ARM), (99, "unknown request 99")])
def test_nobody_is_told_that_was_done_which_this_robot_cannot_do(gate_scene: Scene, verb: int, why: str) -> None:
    assert gate_scene.ask(verb) == (False, why)


def test_a_slot_s_next_session_is_answered_from_its_first_request_on(gate_scene: Scene) -> None:
    for _ in range(3):
        gate_scene.ask(records.DISABLE)
    gate_scene.clients[0].succeed(13, "heir")
    assert gate_scene.ask(records.ENABLE) == (True, "motion enabled")


def test_the_answer_to_an_older_request_does_not_take_the_place_of_a_newer_one_s(gate_scene: Scene) -> None:
    gate_scene.turn()
    slot, now_ns = gate_scene.gate.clients.slots[0], gate_scene.clock()
    gate_scene.gate.requests.take(slot, 7, records.RESET, now_ns, now_ns)
    gate_scene.gate.requests.take(slot, 8, records.DISABLE, now_ns, now_ns)
    gate_scene.decide()
    assert gate_scene.replied() == (8, True, "motion disabled")


def test_a_stop_of_its_own_goes_to_the_port_owner_and_then_to_the_supervisor(gate_scene: Scene) -> None:
    assert gate_scene.ask(records.ENABLE)[0]
    assert records.MOTION in gate_scene.drive(0.1)
    assert gate_scene.drive(float("nan")) == [records.STOP]
    assert "is not finite" in gate_scene.stopped()


def test_a_supervisor_that_is_silent_while_motion_is_enabled_is_a_stop(gate_scene: Scene) -> None:
    lease_ns = gate_scene.settings.ns("gate.lease_s")
    gate_scene.turn(10 * lease_ns, supervisor_beats=False)
    assert gate_scene.latched() is None, "nothing was enabled"
    gate_scene.turn()
    assert gate_scene.ask(records.ENABLE)[0]
    assert gate_scene.turn(lease_ns, supervisor_beats=False) == [records.MOTION]
    assert records.STOP in gate_scene.turn(20 * MS, supervisor_beats=False)
    assert gate_scene.stopped().startswith("supervisor hangs: ")
    assert not gate_scene.gate.core.enabled


def test_nobody_is_enabled_while_the_service_is_not_ready(gate_scene: Scene) -> None:
    gate_scene.ready(0)
    assert gate_scene.ask(records.ENABLE)[1].startswith("not ready: ")
    assert not gate_scene.gate.core.enabled


def test_disabling_writes_a_stop(gate_scene: Scene) -> None:
    gate_scene.ask(records.ENABLE)
    gate_scene.drive(0.1)
    gate_scene.ask(records.DISABLE)
    assert gate_scene.asked == [records.STOP]


def test_a_successor_keeps_the_speed_limit(gate_scene: Scene) -> None:
    assert gate_scene.ask(records.LIMIT) == (False, "a speed limit of 0 %: must be 5 to 100"), "none lies in the slot"
    gate_scene.limit(30)
    assert gate_scene.ask(records.LIMIT) == (True, "speed limited to 30 % of the settings'")
    gate_scene.limit(3)
    assert not gate_scene.ask(records.LIMIT)[0]
    gate_scene.start_gate()
    assert gate_scene.gate.core.limit == 30


def test_a_successor_starts_latched(gate_scene: Scene) -> None:
    gate_scene.stop("key1")
    gate_scene.start_gate()
    assert gate_scene.latched() == "key1"


def test_a_command_that_is_repeated_without_a_ring_does_not_time_out(gate_scene: Scene) -> None:
    gate_scene.turn()
    gate_scene.ask_for(records.ENABLE)
    gate_scene.turn()

    gate_scene.command(0.2)
    gate_scene.turn(MS)
    ends_ns = gate_scene.gate.core.due_ns(gate_scene.clock())
    assert ends_ns
    gate_scene.clock.now_ns = ends_ns - 22 * MS
    gate_scene.tick()
    gate_scene.command(0.2)  # behind the tick's back
    gate_scene.clock.now_ns = ends_ns
    gate_scene.gate.turn({})
    assert gate_scene.gate.core.blocked(gate_scene.clock()) == ""
    assert gate_scene.gate.core.due_ns(gate_scene.clock()) == ends_ns + 298 * MS + 1
