"""The gate at work, as people are told of it: who asked for what, by name, once, and what was left out."""

from __future__ import annotations

from failstop.messages import records
from failstop.procs.gate.main import MOST_RINGS
from failstop.procs.gate.remarks import EVERY_NS, MOST_AT_ONCE
from tests.support.gate_scene import Scene


def test_who_enabled_and_who_disabled_is_told_by_name_when_it_changed_something(scene: Scene) -> None:
    for _ in range(2):
        scene.ask(records.ENABLE)
    for _ in range(2):
        scene.ask(records.DISABLE)
    assert scene.told() == ["motion enabled by test", "motion disabled by test"]


def test_who_enabled_by_way_of_the_drive_pose_is_told_by_name_once(arm_scene: Scene) -> None:
    assert arm_scene.result(records.ENABLE) == (records.DONE, "motion enabled")
    assert arm_scene.told() == ["motion enabled by test"]


def test_who_cleared_a_stop_is_told_by_name(scene: Scene) -> None:
    scene.stop("key1")
    scene.ask(records.RESET)
    assert scene.told() == ["test: latched stop cleared (was: key1); motion still disabled"]


def test_a_stop_that_the_gamepad_cleared_is_no_process_s(scene: Scene) -> None:
    scene.stop("key1")
    scene.pad_resets()
    scene.turn()
    assert scene.told() == ["gamepad: latched stop cleared (was: key1); motion still disabled"]


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
