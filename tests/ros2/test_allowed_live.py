"""A list of who may publish cmd_vel: everybody else is a stranger, and a stop."""

from __future__ import annotations

import pytest

from tests.ros2.scene import BridgeTrial

BRIDGE = ("--ros-args", "-p", "allowed_publishers:=['/nav', 'teleop']")


@pytest.mark.parametrize("who", ["nav", "teleop"])
def test_who_is_on_the_list_drives(scene: BridgeTrial, who: str) -> None:
    scene.scan()
    scene.drive(who)
    scene.enable()
    scene.moving()


def test_a_stranger_latches_and_moves_nothing(scene: BridgeTrial) -> None:
    scene.scan()
    scene.enable()
    scene.trial.board.events()
    scene.drive("intruder")
    estop = scene.state(lambda state: state["estop"])["estop"]
    assert estop == "stranger on cmd_vel: /intruder (allowed: /nav, teleop)"
    assert not [event for event in scene.trial.board.events() if event.is_motion]
