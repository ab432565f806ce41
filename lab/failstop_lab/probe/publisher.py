"""Publisher: the throw-away node of a probe, and its guard.

`python -m failstop_lab.probe.publisher TOPIC STAMPED drive|guard VX`. Lines on standard input: `drive`, `silent` (it
publishes nothing more), `nan` (one NaN, then nothing), `abort` (it ends by an exception, without a zero). A guard is a
watcher (watcher.py), which publishes zeros for a stop.
"""

from __future__ import annotations

import os
import select
import sys
import time
from typing import Any

from failstop.ros2.command import find_rclpy
from failstop.ros2.fill import type_of
from failstop_lab.probe.watcher import Watcher

HZ = 20.0
ZEROS_S = 1.0
GUARD = "guard"


class Node:
    """A publisher of velocities."""

    def __init__(self, topic: str, *, stamped: bool) -> None:
        find_rclpy()
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(f"failstop_probe_{os.getpid()}")
        self._stamped = stamped
        self._kind = type_of(f"geometry_msgs/msg/Twist{'Stamped' if stamped else ''}")
        self._publisher: Any = self._node.create_publisher(self._kind, topic, 10)

    def publish(self, vx: float) -> None:
        """A velocity forward, m/s."""
        message = self._kind()
        if self._stamped:
            message.header.stamp = self._node.get_clock().now().to_msg()
        (message.twist if self._stamped else message).linear.x = vx
        self._publisher.publish(message)

    def zeros(self) -> bool:
        """Publish zeros for a while, because a subscriber may miss one."""
        until_s = time.monotonic() + ZEROS_S
        while time.monotonic() < until_s:
            self.publish(0.0)
            time.sleep(1 / HZ)
        return True


def main(words: list[str]) -> None:
    """Until standard input ends."""
    topic, stamped, what, vx = words
    node = Node(topic, stamped=stamped == "1")
    print("ready", flush=True)
    if what == GUARD:
        Watcher(lambda _: node.zeros()).run()
    else:
        obey(node, float(vx))


def obey(node: Node, vx: float) -> None:
    """Do as standard input says, until it ends."""
    drives = False
    while True:
        if drives:
            node.publish(vx)
        if not select.select([sys.stdin], [], [], 1 / HZ if drives else None)[0]:
            continue
        word = sys.stdin.readline().strip()
        if word == "abort":
            sys.excepthook = lambda *_: None  # a traceback would look like a fault of the probe's
            raise RuntimeError("the probe's way to end it")
        if word == "nan":
            node.publish(float("nan"))
        if word:
            drives = word == "drive"
        else:
            return


if __name__ == "__main__":
    main(sys.argv[1:])
