"""A bridge that is killed and started anew, again and again, while its publisher goes on commanding."""

from __future__ import annotations

from failstop.lab.trial import wait_for
from tests.ros2.scene import BridgeTrial, Ros, new_name
from tests.support.amounts import amount

RESTARTS = amount(3, 40)


def test_nothing_drives_before_an_enable(ros: Ros) -> None:
    with BridgeTrial(ros, new_name()) as scene:
        robot = scene.trial.robot
        scene.scan()
        scene.drive()
        for _ in range(RESTARTS):
            scene.enable()
            scene.moving()
            scene.bridge.kill()
            scene.standing()
            scene.trial.board.events()
            scene.bridge.start()
            scene.state(lambda state: state["blocked"] == "disabled" and state["publishers"] == ["/nav"])
            wait_for("its commands to reach the gate", lambda: robot.state.sources != ())
            assert not [event for event in scene.trial.board.events() if event.is_motion]
