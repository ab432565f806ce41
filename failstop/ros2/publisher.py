"""A node that publishes cmd_vel or a scan until SIGTERM, for the demo and the bench.

Usage: `python -m failstop.ros2.publisher NODE VX [HZ]`. VX is a speed in m/s, or the word scan. The program prints when
its publisher was made (CLOCK_MONOTONIC, ns), and exits cleanly after SIGTERM.
"""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

from failstop.ros2.contract import CMD_VEL, SCAN
from failstop.ros2.fill import fill, type_of

HZ = 20.0


class Ending:
    """Notes a SIGTERM."""

    now = False

    def set(self, _number: int, _frame: object) -> None:
        """The handler of the signal."""
        self.now = True


def main(words: list[str]) -> int:
    """Publish until SIGTERM. Returns the exit code."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    name, what, *rest = words
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    topic, fields = (SCAN, {}) if what == "scan" else (CMD_VEL, {"linear": {"x": float(what)}})
    kind = type_of(topic.type)
    message = fill(kind(), fields)
    ending = Ending()
    signal.signal(signal.SIGTERM, ending.set)
    publisher = node.create_publisher(kind, topic.name, 10)
    sys.stdout.write(f"{time.monotonic_ns()}\n")
    sys.stdout.flush()
    _publish(publisher, message, float(rest[0]) if rest else HZ, ending)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


def _publish(publisher: Any, message: Any, hz: float, ending: Ending) -> None:
    due_s = time.monotonic()
    while not ending.now:
        publisher.publish(message)
        due_s += 1 / hz
        time.sleep(max(0.0, due_s - time.monotonic()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
