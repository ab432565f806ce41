"""A node of the bench, told line by line what to do: `python -m bench.ros2_node NAME`.

steady HZ      publish cmd_vel at 0.2 m/s forward, every other one at 0.195, the time in linear.z (unused by the robot)
rest           stop that
once VX        publish that speed once; the answer is when, in ns
join HZ        a publisher of cmd_vel that drives backward, at once and at HZ
leave          take it away in order
listen         hear cmd_vel with an empty callback that notes when it came
told           the delays since then, in ns
hear TOPIC TYPE    hear a topic and do nothing
bare           do the least that a bridge in rclpy has to: publish messages that never change as often as the bridge
               does, under `bare/`, and hear cmd_vel and scan with empty callbacks
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from failstop.ros2.contract import IMU, ODOMETRY, SCAN, STATE, TWIST
from failstop.ros2.fill import type_of

BARE = ((IMU, 0.009), (ODOMETRY, 0.02), (STATE, 0.1))
"""Topics, and their periods in s; the state with as many bytes as a robot's."""
STATE_BYTES = 1500
FORWARD = (0.2, 0.195)
BACKWARD = -0.2


class Node:
    """Publish and hear."""

    def __init__(self, name: str) -> None:
        rclpy.init(args=[])
        self.node = rclpy.create_node(name)
        self.kind = type_of(TWIST)
        self.steady: Any = None
        self.rival: Any = None
        self.every_s = {"steady": 0.0, "rival": 0.0}
        self.turn = 0
        self.delays: list[int] = []
        threading.Thread(target=self._publish, args=("steady",), daemon=True).start()
        threading.Thread(target=self._publish, args=("rival",), daemon=True).start()

    def _publish(self, which: str) -> None:
        message = self.kind()
        while True:
            every_s, publisher = self.every_s[which], getattr(self, which)
            if every_s and publisher:
                self.turn += 1
                message.linear.x = BACKWARD if which == "rival" else FORWARD[self.turn % 2]
                message.linear.z = float(time.monotonic_ns())
                try:
                    publisher.publish(message)
                except Exception:  # taken away meanwhile
                    continue
            time.sleep(every_s or 0.001)

    def do(self, words: list[str]) -> str:
        """One line; returns the answer."""
        what, *rest = words
        if what == "steady":
            self.steady = self.steady or self.node.create_publisher(self.kind, "cmd_vel", 10)
            self.every_s["steady"] = 1 / float(rest[0])
        elif what == "once":
            message = self.kind()
            message.linear.x, sent_ns = float(rest[0]), time.monotonic_ns()
            message.linear.z = float(sent_ns)
            self.steady.publish(message)
            return str(sent_ns)
        elif what == "rest":
            self.every_s["steady"] = 0.0
        elif what == "join":
            self.rival = self.node.create_publisher(self.kind, "cmd_vel", 10)
            self.every_s["rival"] = 1 / float(rest[0])
        elif what == "leave":
            self.every_s["rival"] = 0.0
            publisher, self.rival = self.rival, None
            self.node.destroy_publisher(publisher)
        elif what == "listen":
            self.node.create_subscription(self.kind, "cmd_vel", self._came, 10)
        elif what == "told":
            found, self.delays = self.delays, []
            return " ".join(map(str, found))
        elif what == "hear":
            self.node.create_subscription(type_of(rest[1]), rest[0], lambda message: None, 10)
        elif what == "bare":
            self.node.create_subscription(self.kind, "cmd_vel", lambda message: None, 10)
            self.node.create_subscription(type_of(SCAN.type), "scan", lambda message: None, 10, raw=True)
            threading.Thread(target=self._bare, daemon=True).start()
        return "done"

    def _bare(self) -> None:
        made = []
        for topic, every_s in BARE:
            kind = type_of(topic.type)
            made.append((self.node.create_publisher(kind, f"bare/{topic.name.strip('~/')}", 10), kind(), every_s))
        made[-1][1].data = "x" * STATE_BYTES
        due_s = [time.monotonic()] * len(made)
        while True:
            for at, (publisher, message, every_s) in enumerate(made):
                if (now_s := time.monotonic()) >= due_s[at]:
                    due_s[at] = max(due_s[at] + every_s, now_s)
                    publisher.publish(message)
            time.sleep(max(0.0, min(due_s) - time.monotonic()))

    def _came(self, message: Any) -> None:
        self.delays.append(time.monotonic_ns() - int(message.linear.z))


def main() -> None:
    """Until the end of the input."""
    node = Node(sys.argv[1])
    executor = SingleThreadedExecutor()
    executor.add_node(node.node)
    threading.Thread(target=executor.spin, daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:
        print(node.do(line.split()), flush=True)
    node.every_s = dict.fromkeys(node.every_s, 0.0)
    node.node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
