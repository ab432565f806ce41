"""ROS 2: a probe of whatever obeys a topic of velocities, by a publisher in a process of its own, judged by odometry.

The judge is this process; publisher.py is the one that fails. A guard of its own (publisher.py as `guard`) publishes
zeros when the probe is gone, whichever way it went.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from failstop.api.errors import FailstopError
from failstop.lab.probe import judge
from failstop.lab.probe.card import Row
from failstop.lab.prove.sight import SeenSample
from failstop.ros2.command import find_rclpy
from failstop.ros2.fill import type_of
from failstop.setup.ending import end_with_parent

VX_MPS = 0.1
TURNS_S = 1.5
SEEN_S = 20.0
SPIN_S = 0.01
ODOM_TYPE = "nav_msgs/msg/Odometry"
ROWS = {
    "silence": "its publisher falls silent",
    "sigkill": "its publisher is killed (SIGKILL)",
    "sigstop": "its publisher hangs (SIGSTOP)",
    "abort": "its publisher ends by an exception",
    "nan": "it is sent NaN, then nothing",
    "two": "two publish at once, and one is killed",
    "driver": "its driver's node is killed (SIGKILL)",
}
SENT = {"silence": "silent", "abort": "abort", "nan": "nan"}
"""Rows that the publisher is told to bring about, with the word for it."""
SIGNALLED = {"sigkill": signal.SIGKILL, "sigstop": signal.SIGSTOP, "two": signal.SIGKILL}


class Publisher:
    """A process of publisher.py."""

    def __init__(self, topic: str, *, stamped: bool, what: str = "drive", keep: bool = False) -> None:
        """`keep`: it outlives this process, to guard."""
        words = [sys.executable, "-m", "failstop.lab.probe.publisher", topic, str(int(stamped)), what, str(VX_MPS)]
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=keep,
            preexec_fn=None if keep else end_with_parent,
        )
        assert self.process.stdout
        if not self.process.stdout.readline():
            raise FailstopError(f"no publisher on {topic}: does `ros2 topic list` work in this shell?")

    def told(self, word: str) -> None:
        """Send it a line."""
        assert self.process.stdin
        with contextlib.suppress(OSError):
            self.process.stdin.write(f"{word}\n")
            self.process.stdin.flush()

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()


class Listener:
    """Odometry as samples: speeds forward, sideways and turning."""

    def __init__(self, topic: str) -> None:
        find_rclpy()
        import rclpy

        self._rclpy: Any = rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("failstop_probe")
        self.samples: list[SeenSample] = []
        # It hears reliable publishers too.
        profile = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(type_of(ODOM_TYPE), topic, self._take, profile)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)

    def _take(self, message: Any) -> None:
        twist, pose = message.twist.twist, message.pose.pose
        speeds = (twist.linear.x, twist.linear.y, twist.angular.z)
        places = (pose.position.x, pose.position.y, pose.orientation.z)
        self.samples.append((time.monotonic_ns(), speeds, places))

    def until(self, seconds: float, found: Callable[[], bool] = lambda: False) -> bool:
        """Listen for a while; True as soon as `found` is."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self._executor.spin_once(timeout_sec=SPIN_S)
            if found():
                return True
        return False

    def turning(self) -> bool:
        """Whether it says that it moves."""
        last = self.samples[-2:]
        return len(last) == 2 and judge.rest_ns(last) != last[0][0]

    def close(self) -> None:
        """Leave."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()


def rows(arguments: Namespace, names: Iterable[str], say: Callable[[str], None]) -> Iterator[Row]:
    """Each row as it is found. Raises FailstopError."""
    topic, stamped = arguments.cmd_vel, arguments.stamped
    listener = Listener(arguments.odom)
    guard = None
    try:
        guard = Publisher(topic, stamped=stamped, what="guard", keep=True)
        for name in names:
            words = ROWS[name]
            if name == "driver" and not arguments.driver_pid:
                yield Row(name, words, skipped="give --driver-pid")
                continue
            say(f"{words} ...")
            yield _row(name, arguments, listener, guard, say)
    finally:
        if guard and guard.process.stdin:
            guard.process.stdin.close()  # it publishes zeros, and ends
        listener.close()


def _row(name: str, arguments: Namespace, listener: Listener, guard: Publisher, say: Callable[[str], None]) -> Row:
    topic, stamped = arguments.cmd_vel, arguments.stamped
    publishers = [Publisher(topic, stamped=stamped) for _ in range(2 if name == "two" else 1)]
    try:
        if not arguments.key and not listener.until(SEEN_S, listener.turning):
            raise FailstopError(f"{arguments.odom} did not say within {SEEN_S:g} s that it moves: is its driver there?")
        listener.until(TURNS_S)
        if arguments.key:
            say("Press Enter as soon as the wheels stand.")
            judge.key_pressed()
        listener.samples.clear()
        cause_ns = time.monotonic_ns()
        if name == "driver":
            os.kill(arguments.driver_pid, signal.SIGKILL)
        elif word := SENT.get(name):
            for publisher in publishers:
                publisher.told(word)
        else:
            os.kill(publishers[0].process.pid, SIGNALLED[name])
        if name == "two":
            publishers[1].told("silent")
        rest = _stands(arguments.key, listener)
    finally:
        for publisher in publishers:
            publisher.end()
        guard.told("zero")
        listener.until(judge.RESTS_S)
    seconds, within_s = None if rest is None else (rest - cause_ns) / 1e9, 0.0
    if rest is not None and not arguments.key:
        seconds, within_s = judge.dated(listener.samples, cause_ns, rest)
    note = ""
    if name == "driver" and not arguments.key and not listener.samples:
        seconds, note = None, "its odometry ended with it: look at the wheels, and use --key"
    by = judge.PERSON if arguments.key else judge.ODOMETER
    return Row(name, ROWS[name], seconds, by, note=note, within_s=within_s, cause_ns=cause_ns)


def _stands(by_key: bool, listener: Listener) -> int | None:
    if by_key:
        return time.monotonic_ns() if listener.until(judge.NEVER_S, judge.key_pressed) else None

    def stands() -> bool:
        return len(listener.samples) > 1 and judge.believed(listener.samples, judge.rest_ns(listener.samples))

    return judge.rest_ns(listener.samples) if listener.until(judge.NEVER_S + judge.RESTS_S, stands) else None
