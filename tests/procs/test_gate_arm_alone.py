"""Notes of an arm that nobody moves: faults of its servos, and that it tucks itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from failstop.messages import records
from failstop.messages.packing import Note
from tests.support.arm_settings import SERVOS, TUCK
from tests.support.gate_scene import Scene

from .arm_bench import Make


@pytest.fixture
def scene(arm_scene: Scene) -> Scene:
    return arm_scene


def notes(scene: Scene) -> Callable[[], list[tuple[str, str]]]:
    """(level, text) of what people are told of the arm from now on, since the last call."""
    ring = scene.own.ring_reader("notes")

    def news() -> list[tuple[str, str]]:
        found = [Note.unpack(entry[2]) for entry in iter(ring.next, None)]
        return [(note.level, note.text) for note in found if note.kind == "arm"]

    return news


# What is wrong with a servo.

FAULTS: dict[int, dict[str, Any]] = {2: {"silent": True}, 3: {"temperature_c": 70}, 4: {"supply_mv": 5999}}
TOLD = {
    "shoulder (servo 2)": "does not answer",
    "elbow (servo 3)": "is hot: 70 degrees or more; at 85 it lets go",
    "wrist (servo 4)": "has less than 6000 mV; with little less it lets go",
}


def test_faults_of_servos_are_told_once_and_their_end(scene: Scene) -> None:
    news = notes(scene)
    scene.run(10.0)
    assert news() == []
    for servo, fault in FAULTS.items():
        scene.servos.change(servo, scene.clock(), **fault)
    scene.run(10.0)
    assert sorted(news()) == sorted(("warning", f"joint {of} {text}") for of, text in TOLD.items())
    assert sorted(scene.state()["wrong"]) == sorted(f"joint {of.partition(' ')[0]} {text}" for of, text in TOLD.items())
    assert scene.state()["silent"] == [2]
    for servo in FAULTS:
        scene.servos.change(servo, scene.clock(), silent=False, temperature_c=69, supply_mv=6000)
    scene.run(10.0)
    assert sorted(news()) == sorted(("", f"joint {of} is well again") for of in TOLD)
    assert scene.state()["wrong"] == []


# The tuck of an arm that is left alone.


def test_arm_that_is_left_alone_says_so_and_tucks_itself_on_time(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=5.0, arm__tuck_notice_s=2.0)
    news = notes(scene)
    scene.run(6.0)
    assert scene.moves == [], "never used, never tucked"
    assert scene.state()["auto_tuck_s"] is None
    scene.execute({1: 0.5})
    scene.finish()
    assert scene.state()["auto_tuck_s"] == 5
    assert not scene.state()["tucks"]
    alone_ns = scene.clock()
    scene.run(2.9)
    assert news() == []
    scene.run(0.2)
    assert news() == [("", "the arm was left alone: it goes to its tuck pose in 2 s")]
    assert scene.state()["tucks"]
    assert scene.state()["auto_tuck_s"] == 2
    count = len(scene.moves)
    scene.run(3.0)
    assert scene.state()["by"] == "auto-tuck"
    assert scene.state()["auto_tuck_s"] is None
    assert not scene.state()["tucks"]
    began_s = (scene.moves[count][0] - alone_ns) * 1e-9
    assert 4.9 < began_s < 5.3
    scene.run(10.0)
    assert [scene.at(servo) for servo in SERVOS] == pytest.approx(TUCK, abs=2)
    assert scene.state()["pose"] == "tuck"
    scene.run(7.0)
    assert news() == []


def test_arm_that_is_used_again_before_it_tucks_is_announced_anew(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=10.0)
    news = notes(scene)
    scene.execute({1: 0.5})
    scene.finish()
    scene.run(7.0)
    assert len(news()) == 1
    scene.execute({1: 0.4})
    scene.finish()
    scene.run(4.5)
    assert news() == []
    scene.run(1.5)
    assert len(news()) == 1
    scene.ask_for(records.ENABLE)
    assert scene.finish()[0] == records.DONE
    scene.run(12.0)
    assert news() == [], "wheels enabled: it must not"
    assert scene.state()["auto_tuck_s"] in (None, 10)
    scene.ask_for(records.DISABLE)
    scene.run(9.0)
    assert len(news()) == 1
    scene.run(6.0)
    assert scene.state()["pose"] == "tuck" or scene.state()["by"] == "auto-tuck"


def test_arm_that_was_put_into_its_tuck_pose_announces_nothing(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=6.0)
    news = notes(scene)
    scene.ask_for(records.ARM_TUCK)
    assert scene.finish(most_s=20.0) == (records.DONE, "arm is there")
    assert scene.state()["auto_tuck_s"] is None
    scene.run(8.0)
    assert news() == []


def test_arm_without_auto_tuck_stays_where_it_is(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck="off", arm__auto_tuck_s=1.0)
    scene.execute({1: 0.5})
    scene.finish()
    scene.run(10.0)
    assert scene.at(1) > 600


def test_released_arm_stays_limp_until_it_is_asked_to_move(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=1.0, arm__tuck_notice_s=0.5)
    scene.execute({1: 0.2})
    scene.finish()
    scene.ask_for(records.ARM_RELEASE)
    for seconds in (0.2, 10.0):
        scene.run(seconds)
        assert all(servo.limp() for servo in scene.servos.by_id.values())
    scene.execute({1: 0.1})
    assert scene.finish() == (records.DONE, "arm is there")


def test_tuck_that_fails_is_told(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5)
    news = notes(scene)
    scene.execute({1: 0.5})
    scene.finish()
    scene.servos.change(2, scene.clock(), blocked=True)
    scene.run(15.0)
    (_, announced), (level, failed), *_ = news()
    assert announced.startswith("the arm was left alone")
    assert level == "warning"
    assert failed.startswith("the arm did not tuck itself: joint shoulder (servo 2) is 46")


def test_tuck_that_can_not_begin_is_not_tried_again(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5)
    scene.execute({1: 0.5})
    scene.finish()
    for servo in SERVOS:
        scene.servos.change(servo, scene.clock(), silent=True)
    news = notes(scene)
    scene.run(12.0)
    assert any("did not tuck itself" in text for _, text in news())
    scene.run(8.0)
    assert news() == []


def test_tuck_that_somebody_ends_is_no_fault(arm_with: Make) -> None:
    scene = arm_with(arm__auto_tuck_s=2.0, arm__tuck_notice_s=0.5)
    news = notes(scene)
    scene.execute({1: 0.5})
    scene.finish()
    scene.run(3.0)
    assert scene.state()["by"] == "auto-tuck"
    scene.ask_for(records.ARM_HOLD)
    scene.run(0.2)
    assert [level for level, _ in news()] == [""]
