"""Driving by cmd_vel: what reaches the wheels, judged by the board."""

from __future__ import annotations

from failstop.trial import wait_for
from tests.ros2.scene import Scene


def test_cmd_vel_drives(scene: Scene) -> None:
    scene.scan()
    scene.drive()
    scene.enable()
    scene.moving()
    state = scene.state(lambda state: state["body_vel"] == [0.2, 0.0, 0.0])
    assert state["publishers"] == ["/nav"]
    wait_for("full speed", lambda: abs(scene.trial.board.wheels()[0] - 0.796) < 0.001)
