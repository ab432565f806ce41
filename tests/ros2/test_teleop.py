"""ROS's own teleop_twist_keyboard, told to publish TwistStamped as newer ROS do: it drives, and is stopped. On a real
ROS that has it alone."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from failstop_lab.trial import wait_for
from tests.ros2.scene import BridgeTrial, Ros

TELEOP = "import teleop_twist_keyboard; teleop_twist_keyboard.main()"
FORWARD, ANYTHING = b"i", b"k"
REPEATED_S = 0.05
"""How often a keyboard repeats a key that is held down."""


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    found = Ros("real", tmp_path_factory.mktemp("ros"))
    if found.run(sys.executable, "-c", "import teleop_twist_keyboard").returncode:
        pytest.skip("not installed: teleop_twist_keyboard of ROS 2")
    return found


class Teleop:
    """The program at a terminal, with a key that a test holds down."""

    def __init__(self, ros: Ros) -> None:
        self.keyboard, inside = pty.openpty()
        words = (sys.executable, "-c", TELEOP, "--ros-args", "-p", "stamped:=true")
        self.process = subprocess.Popen(words, env=ros.environment, stdin=inside, stdout=subprocess.DEVNULL)
        os.close(inside)

    @contextlib.contextmanager
    def holding(self, key: bytes) -> Iterator[None]:
        """This key is held down until the end."""
        up = threading.Event()

        def repeat() -> None:
            while not up.wait(REPEATED_S):
                with contextlib.suppress(OSError):  # the program has ended
                    os.write(self.keyboard, key)

        thread = threading.Thread(target=repeat)
        thread.start()
        try:
            yield
        finally:
            up.set()
            thread.join()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.keyboard)


@pytest.fixture
def teleop(ros: Ros) -> Iterator[Teleop]:
    made = Teleop(ros)
    yield made
    made.close()


def test_a_stamped_teleop_drives_and_is_stopped(scene: BridgeTrial, teleop: Teleop) -> None:
    scene.scan()
    scene.enable()
    with teleop.holding(FORWARD):
        scene.moving()
        assert scene.state(lambda state: state["publishers"])["publishers"] == ["/teleop_twist_keyboard"]
    scene.standing()  # the key was released, and the last command got too old
    with teleop.holding(FORWARD):
        scene.moving()
        stopped, _ = scene.eyes.call("stop")
        assert stopped
        scene.standing()
    with teleop.holding(ANYTHING):
        # It is refused until the keys that were typed before have all become commands, and zeros come.
        wait_for("a reset to be taken", lambda: scene.eyes.call("reset_estop")[0])
    scene.enable()
    with teleop.holding(FORWARD):
        scene.moving()
        teleop.process.kill()
        scene.standing()


def test_its_messages_are_stamped(scene: BridgeTrial, teleop: Teleop) -> None:
    watcher = scene.node("watcher")
    watcher.hear("cmd_vel", "geometry_msgs/msg/TwistStamped")
    with teleop.holding(FORWARD):
        message = watcher.next("cmd_vel")
    assert message["header"]["stamp"]["sec"] > 1_600_000_000
    assert message["twist"]["linear"]["x"] > 0.0
