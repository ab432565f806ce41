"""The gate's shell, turn by turn: what it hands to the port owner and the supervisor, and whom it refuses."""

from __future__ import annotations

import pytest

from failstop.messages import records
from failstop.procs.gate.main import MOST_RINGS, NO_ARM
from failstop.procs.gate.remarks import EVERY_NS, MOST_AT_ONCE
from tests.support.gate_scene import Scene
from tests.support.stage import MS


def test_an_enable_that_comes_after_a_later_disable_moves_nothing(scene: Scene) -> None:
    asked_ns = scene.clock() - 1
    assert scene.ask(records.DISABLE)[0]
    assert scene.ask(records.ENABLE, asked_ns) == (False, "a later request took its place: ask again")
    assert scene.ask(records.ENABLE)[0]


def test_a_disable_dated_in_the_future_keeps_nobody_from_enabling(scene: Scene) -> None:
    assert scene.ask(records.DISABLE, scene.clock() + 10_000 * MS)[0]
    scene.turn(20 * MS)
    assert scene.ask(records.ENABLE)[0]


@pytest.mark.parametrize(("verb", "why"), [(records.ARM_TUCK, NO_ARM), (99, "unknown request 99")])
def test_nobody_is_told_that_was_done_which_this_robot_cannot_do(scene: Scene, verb: int, why: str) -> None:
    assert scene.ask(verb) == (False, why)


def test_a_slot_s_next_session_is_answered_from_its_first_request_on(scene: Scene) -> None:
    for _ in range(3):
        scene.ask(records.DISABLE)
    scene.clients[0].succeed(13, "heir")
    assert scene.ask(records.ENABLE) == (True, "motion enabled")


def test_the_answer_to_an_older_request_does_not_take_the_place_of_a_newer_one_s(scene: Scene) -> None:
    scene.turn()
    slot, now_ns = scene.gate.clients.slots[0], scene.clock()
    scene.gate.take_request(now_ns, slot, now_ns, 7, records.RESET)
    scene.gate.take_request(now_ns, slot, now_ns, 8, records.DISABLE)
    scene.decide()
    assert scene.replied() == (8, True, "motion disabled")


def test_a_stop_of_its_own_goes_to_the_port_owner_and_then_to_the_supervisor(scene: Scene) -> None:
    assert scene.ask(records.ENABLE)[0]
    assert records.MOTION in scene.drive(0.1)
    scene.ask(records.DISABLE)
    assert scene.asked == [records.WRITE_BURST], "a disable writes one too"
    assert scene.ask(records.ENABLE)[0]
    assert scene.drive(float("nan")) == [records.WRITE_BURST]
    assert "is not finite" in scene.stopped()


def test_a_supervisor_that_is_silent_while_motion_is_enabled_is_a_stop(scene: Scene) -> None:
    lease_ns = scene.settings.ns("gate.lease_s")
    scene.turn(10 * lease_ns, supervisor_beats=False)
    assert scene.latched() is None, "nothing was enabled"
    scene.turn()
    assert scene.ask(records.ENABLE)[0]
    assert scene.turn(lease_ns, supervisor_beats=False) == [records.MOTION]
    assert records.WRITE_BURST in scene.turn(20 * MS, supervisor_beats=False)
    assert scene.stopped().startswith("supervisor hangs: ")
    assert not scene.gate.core.enabled


def test_nobody_is_enabled_while_the_service_is_not_ready(scene: Scene) -> None:
    scene.ready(0)
    assert scene.ask(records.ENABLE)[1].startswith("not ready: ")
    assert not scene.gate.core.enabled


def test_a_successor_keeps_the_speed_limit(scene: Scene) -> None:
    assert scene.ask(records.LIMIT) == (False, "a speed limit of 0 %: must be 5 to 100"), "none lies in the slot"
    scene.limit(30)
    assert scene.ask(records.LIMIT) == (True, "speed limited to 30 % of the settings'")
    scene.limit(3)
    assert not scene.ask(records.LIMIT)[0]
    scene.start_gate()
    assert scene.gate.core.limit == 30


def test_a_command_that_is_repeated_without_a_ring_does_not_time_out(scene: Scene) -> None:
    scene.turn()
    scene.ask_for(records.ENABLE)
    scene.turn()

    scene.command(0.2)
    scene.turn(MS)
    ends_ns = scene.gate.core.due_ns(scene.clock())
    assert ends_ns
    scene.clock.now_ns = ends_ns - 22 * MS
    scene.tick()
    scene.command(0.2)  # behind the tick's back
    scene.clock.now_ns = ends_ns
    scene.gate.turn({})
    assert scene.gate.core.blocked(scene.clock()) == ""
    assert scene.gate.core.due_ns(scene.clock()) == ends_ns + 298 * MS + 1


# What people are told: who asked for what, by name, once, and what was left out.


def test_an_enable_and_a_disable_are_told_by_name_when_they_changed_something(scene: Scene) -> None:
    for _ in range(2):
        scene.ask(records.ENABLE)
    for _ in range(2):
        scene.ask(records.DISABLE)
    assert scene.told() == ["motion enabled by test", "motion disabled by test"]


def test_an_enable_by_way_of_the_drive_pose_is_told_by_name_once(arm_scene: Scene) -> None:
    assert arm_scene.result(records.ENABLE) == (records.DONE, "motion enabled")
    assert arm_scene.told() == ["motion enabled by test"]


def test_a_stop_is_cleared_by_name_and_by_the_gamepad_by_no_process(scene: Scene) -> None:
    scene.stop("key1")
    scene.ask(records.RESET)
    scene.stop("key1")
    scene.pad_resets()
    scene.turn()
    cleared = "latched stop cleared (was: key1); motion still disabled"
    assert scene.told() == [f"test: {cleared}", f"gamepad: {cleared}"]


def test_after_a_flood_of_refusals_how_many_were_left_out_is_told_once(scene: Scene) -> None:
    for number in range(MOST_AT_ONCE + 5):
        if number == MOST_RINGS - 1:
            scene.tick()  # or the gate would hear no more rings
        scene.ask(99)
    refused = "refused to 99, test: unknown request 99"
    assert scene.told() == [refused] * MOST_AT_ONCE
    left_out = "and 5 more requests, too many to tell of each"
    for expected in ([refused, left_out], [refused]):
        scene.turn(EVERY_NS)
        scene.ask(99)
        assert scene.told() == expected


def restarted(scene: Scene, after_ns: int = 80 * MS) -> None:
    """The gate dies, which is a stop, and another one starts after a while."""
    scene.clock.now_ns += MS
    scene.stop("gate died")
    scene.clock.now_ns += after_ns
    scene.start_gate()
    scene.turn()


def test_a_reset_that_no_gate_has_heard_is_answered_by_the_next_one(scene: Scene) -> None:
    scene.turn()
    scene.stop("gate died")
    scene.clock.now_ns += MS
    scene.ask_for(records.RESET)
    scene.start_gate()
    scene.turn()
    assert (scene.answered()[0], scene.latched()) == (records.DONE, None)
    assert not scene.gate.core.enabled


def test_what_was_asked_of_a_gate_before_its_death_moves_nothing_by_the_next_one(scene: Scene) -> None:
    scene.turn()
    scene.ask_for(records.ENABLE)
    restarted(scene)
    assert scene.answered() == (
        records.REFUSED,
        "asked before the last stop (gate died): see to that, then ask again",
    )


def test_what_was_answered_before_the_gate_s_death_is_not_done_again(scene: Scene) -> None:
    scene.limit(50)
    assert scene.ask(records.LIMIT)[0]
    before = scene.replied()
    restarted(scene)
    scene.told()
    scene.turn()
    assert (scene.replied(), scene.told()) == (before, [])


def test_a_request_that_nobody_waits_for_any_more_is_not_done(scene: Scene) -> None:
    scene.turn()
    scene.stop("gate died")
    scene.clock.now_ns += MS
    scene.ask_for(records.RESET)
    scene.clock.now_ns += records.ANSWER_WITHIN_NS + MS
    scene.start_gate()
    scene.turn()
    assert scene.answered() == (records.REFUSED, "the gate has started since: ask again")
    assert scene.latched() == "gate died"
