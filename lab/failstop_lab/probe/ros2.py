"""ROS 2: a probe of whatever obeys a topic of velocities, by a publisher in a process of its own, judged by odometry or
IMU.

The judge is this process; publisher.py is the one that fails. A guard of its own (publisher.py as `guard`) kills what
publishes, and publishes zeros, when the probe is gone, whichever way it went, or hangs.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from failstop import helpers
from failstop.api.errors import FailstopError
from failstop.policy.halted import Halted
from failstop.ros2.command import find_rclpy
from failstop.ros2.fill import type_of
from failstop.setup.ending import end_with_parent, uninterrupted
from failstop_lab.probe import judge
from failstop_lab.probe.card import Row
from failstop_lab.probe.publisher import GUARD
from failstop_lab.probe.watcher import STOP_WORD, Orders
from failstop_lab.prove import shake
from failstop_lab.prove.sight import SeenSample

VX_MPS = 0.1
TURNS_S = 1.5
SEEN_S = 20.0
SPIN_S = 0.01
STILL_S = 2.0
JOINS_S = 60.0
"""How long a publisher may take to start."""
SEES_REST_S = 3.0
"""How long the robot may take to be seen at rest after a stop."""
STARTS_S = 3.0
"""For a base that no odometry speaks for to hear of a publisher, and to turn its wheels."""
SHAKES_NS = 700_000_000
"""Long enough for a window of shaking (shake.py)."""
ODOM_TYPE, IMU_TYPE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
ROWS = {
    "silence": "its publisher falls silent",
    "sigkill": "its publisher is killed (SIGKILL)",
    "sigstop": "its publisher hangs (SIGSTOP)",
    "abort": "its publisher ends with an exception",
    "nan": "it is sent NaN, then nothing",
    "two": "two publish at once, and one is killed",
    "driver": "its driver's node is killed (SIGKILL)",
}
SENT = {"silence": "silent", "abort": "abort", "nan": "nan"}
"""Rows that the publisher is told to bring about, with the word for it."""
SIGNALLED = {"sigkill": signal.SIGKILL, "sigstop": signal.SIGSTOP, "two": signal.SIGKILL}
ORPHANED = "The driver was killed, so the probe's stop may reach nobody: if a wheel turns, switch off the power."
NOBODY_OBEYS = "its driver was killed, so nobody obeys it any more"


class Publisher:
    """A process of publisher.py."""

    def __init__(self, topic: str, *, stamped: bool, what: str = "drive", keep: bool = False) -> None:
        """`keep`: it outlives this process, to guard."""
        words = helpers.python("failstop_lab.probe.publisher", topic, str(int(stamped)), what, str(VX_MPS))
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=keep,
            preexec_fn=None if keep else end_with_parent,
        )
        assert self.process.stdout
        heard = select.select([self.process.stdout], [], [], JOINS_S)[0]
        if not (heard and self.process.stdout.readline()):
            self.end()
            raise FailstopError(f"no publisher on {topic}: does `ros2 topic list` work in this shell?")

        self.orders = Orders(self.process)
        """Gives orders to the process, if it is a guard."""

    def send(self, word: str) -> None:
        """Send the process a line."""
        assert self.process.stdin
        with contextlib.suppress(OSError):
            self.process.stdin.write(f"{word}\n")
            self.process.stdin.flush()

    def left(self) -> None:
        """Let a guard publish its zeros, and end."""
        assert self.process.stdin
        with contextlib.suppress(OSError):
            self.process.stdin.close()

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()


class Listener:
    """The judge's samples: of an odometry speeds forward, sideways and turning with places, of an IMU its gyro."""

    def __init__(self, arguments: Namespace, here: Callable[[], None]) -> None:
        """`here`: called all the while it listens."""
        find_rclpy()
        import rclpy

        self._here = here
        self._rclpy: Any = rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("failstop_probe")
        self.samples: list[SeenSample] = []
        self.topic = arguments.imu or arguments.odom
        self.shaking: judge.Shaking | None = None
        """Tells rest from turning by the IMU, once the IMU has shown both. None: not yet, or the odometry judges."""
        self.judges = not arguments.imu
        """Whether it can tell rest from turning, as far as is known."""
        kind, take = (IMU_TYPE, self._add_gyro) if arguments.imu else (ODOM_TYPE, self._add_odometry)
        # It hears reliable publishers too.
        profile = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(type_of(kind), self.topic, take, profile)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)

    def _add_odometry(self, message: Any) -> None:
        twist, pose = message.twist.twist, message.pose.pose
        speeds = (twist.linear.x, twist.linear.y, twist.angular.z)
        places = (pose.position.x, pose.position.y, pose.orientation.z)
        self.samples.append((time.monotonic_ns(), speeds, places))

    def _add_gyro(self, message: Any) -> None:
        self.samples.append((time.monotonic_ns(), message.angular_velocity.x, message.angular_velocity.y))

    def until(self, seconds: float, found: Callable[[], bool] = lambda: False) -> bool:
        """Listen for a while; True as soon as `found` is."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self._here()
            self._executor.spin_once(timeout_sec=SPIN_S)
            if found():
                return True
        return False

    def stretch(self, seconds: float) -> list[SeenSample]:
        """The samples of a while from now on."""
        self.samples.clear()
        self.until(seconds)
        return list(self.samples)

    def turning(self) -> bool:
        """Whether it says that it moves."""
        if self.shaking:
            lately_ns = time.monotonic_ns() - SHAKES_NS
            lately = [sample for sample in self.samples if sample[0] >= lately_ns]
            return shake.turning(lately, self.shaking.least)
        last = self.samples[-2:]
        return len(last) == 2 and judge.rest_ns(last) != last[0][0]

    def rest_ns(self) -> int | None:
        """The first sample of the rest in which they end; None: they end in a turn."""
        return self.shaking.rest_ns(self.samples) if self.shaking else judge.rest_ns(self.samples)

    def alone(self) -> None:
        """Listen without a guard from now on."""
        self._here = lambda: None

    def still(self) -> bool | None:
        """Whether it says that the robot is at rest, as soon as that has lasted; None: it says nothing, or
        can't tell."""
        if not self.judges:
            return None
        self.samples.clear()
        self.until(SEES_REST_S, lambda: len(self.samples) > 1 and judge.believed(self.samples, self.rest_ns()))
        return judge.believed(self.samples, self.rest_ns()) if len(self.samples) > 1 else None

    def close(self) -> None:
        """Leave."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()


class RosProbe:
    """A context manager. At its end the guard publishes zeros, and another guard does if that one fails; `outcome` is
    what is known then."""

    def __init__(self, arguments: Namespace, say: Callable[[str], None]) -> None:
        self._arguments, self._say = arguments, say
        self._guard: Publisher | None = None
        self._listener: Listener | None = None
        self._orphaned = False
        """The driver was killed, and its wheels were not seen to stop."""
        self.outcome: Halted | None = None
        """What is known of the wheels at the end; None: they were never to turn."""

    def __enter__(self) -> RosProbe:
        self._guard = self._guarding()
        try:
            self._listener = Listener(self._arguments, self._guard.orders.here)
        except BaseException:
            self._guard.left()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        with uninterrupted():
            self.close()

    def _guarding(self) -> Publisher:
        return Publisher(self._arguments.cmd_vel, stamped=self._arguments.stamped, what=GUARD, keep=True)

    def rows(self, names: Iterable[str]) -> Iterator[Row]:
        """Each row as it is found. Raises FailstopError."""
        arguments, listener, guard = self._arguments, self._listener, self._guard
        assert listener
        assert guard
        if arguments.imu and not arguments.key:
            self._say("first, what the IMU measures while the wheels are still and while they turn ...")
            _character(arguments, listener, guard)
        elif not arguments.key:
            self._say("first, what the odometry reports while the wheels are still ...")
            _check_rest(listener)
        for name in sorted(names, key=lambda each: each == "driver"):  # the others need the driver
            words = ROWS[name]
            if name == "driver" and not arguments.driver_pid:
                yield Row(name, words, skipped="give --driver-pid")
                continue
            self._say(f"{words} ...")
            row = _row(name, arguments, listener, guard, self._say, self._kill_driver)
            self._orphaned &= row.stands_s is None
            yield row

    def _kill_driver(self) -> None:
        self._orphaned = True
        os.kill(self._arguments.driver_pid, signal.SIGKILL)

    def close(self) -> None:
        """Publish zeros, listen to what becomes of the wheels, and leave."""
        why = self._stopped()
        still = None
        if self._listener:
            self._listener.alone()
            still = None if self._arguments.key or why else self._listener.still()
            self._listener.close()
            by = self._listener.topic
            if self._orphaned and not still:
                why = why or NOBODY_OBEYS
            self.outcome = Halted(self._arguments.cmd_vel, written=not why, why=why, still=still, by=by)

    def _stopped(self) -> str:
        """Have the guard publish zeros, or a new one if it can't; returns why neither did, empty if one has."""
        why = ""
        for guard in (self._guard, None):
            try:
                guard = guard or self._guarding()
                guard.orders.give(STOP_WORD)
            except FailstopError as error:
                why = str(error)
                if guard:
                    guard.end()
            else:
                guard.left()
                return ""
        return why


@contextlib.contextmanager
def _driving(arguments: Namespace, listener: Listener, guard: Publisher, count: int = 1) -> Iterator[list[Publisher]]:
    """So many publishers, which drive; whatever becomes of them, the wheels stand at the end."""
    publishers = [Publisher(arguments.cmd_vel, stamped=arguments.stamped) for _ in range(count)]
    try:
        for publisher in publishers:  # the guard knows of each before it drives
            guard.orders.give(f"drive {publisher.process.pid}")
            publisher.send("drive")
        yield publishers
    finally:
        try:
            guard.orders.give(STOP_WORD)
        finally:
            for publisher in publishers:
                publisher.end()
        listener.until(judge.RESTS_S)


def _check_rest(listener: Listener) -> None:
    """Raises FailstopError where the odometry of a robot at rest does not show that, as one that an IMU has a part in:
    it would never stop by that."""
    if listener.until(STARTS_S, lambda: bool(listener.samples)) and listener.still() is False:
        listener.judges = False
        raise FailstopError(f"{listener.topic} does not show that the robot is at rest now: use --imu or --key")


def _character(arguments: Namespace, listener: Listener, guard: Publisher) -> None:
    """How the IMU feels rest and turning. Raises FailstopError where it can't tell them apart."""
    still = shake.noise(listener.stretch(STILL_S))
    with _driving(arguments, listener, guard):
        listener.until(STARTS_S)
        spinning = shake.noise(listener.stretch(TURNS_S))
    shaking = judge.Shaking(still, spinning) if still and spinning else None
    if shaking is None or not shaking.distinguishes:
        what = "does not show whether the wheels turn" if shaking else "publishes too little"
        raise FailstopError(f"{arguments.imu} {what}: leave --imu out, or use --key")
    listener.shaking, listener.judges = shaking, True


def _row(
    name: str,
    arguments: Namespace,
    listener: Listener,
    guard: Publisher,
    say: Callable[[str], None],
    kill_driver: Callable[[], None],
) -> Row:
    with _driving(arguments, listener, guard, 2 if name == "two" else 1) as publishers:
        if not arguments.key and not listener.until(SEEN_S, listener.turning):
            raise FailstopError(f"{listener.topic} reported no motion within {SEEN_S:g} s: is its driver running?")
        listener.samples.clear()
        listener.until(STARTS_S if arguments.key else TURNS_S)
        if arguments.key:
            say(judge.PRESS)
            judge.key_pressed()
        elif judge.rested(listener.samples, listener.rest_ns()):
            return Row(name, ROWS[name], unjudged=judge.NOT_TURNING)
        listener.samples.clear()
        cause_ns = time.monotonic_ns()
        if name == "driver":
            kill_driver()
        elif word := SENT.get(name):
            for publisher in publishers:
                publisher.send(word)
        else:
            os.kill(publishers[0].process.pid, SIGNALLED[name])
        if name == "two":
            publishers[1].send("silent")
        rest = _stands(listener, by_key=arguments.key)
        if name == "driver" and rest is None:
            say(ORPHANED)
        last, now_ns = list(listener.samples), time.monotonic_ns()
    unjudged = ""
    if rest is None and arguments.key:
        unjudged = judge.turned_on(say, listener.until)
    elif rest is None and judge.silent(last, now_ns):
        unjudged = judge.NO_REPORTS.format(listener.topic)
    seconds, within_s = None if rest is None else (rest - cause_ns) / 1e9, 0.0
    if rest is not None and not arguments.key:
        seconds, within_s = judge.dated(last, cause_ns, rest)
    by = judge.PERSON if arguments.key else judge.ROS_IMU if arguments.imu else judge.ODOMETER
    return Row(name, ROWS[name], seconds, by, within_s=within_s, cause_ns=cause_ns, unjudged=unjudged)


def _stands(listener: Listener, *, by_key: bool) -> int | None:
    if by_key:
        return time.monotonic_ns() if listener.until(judge.NEVER_S, judge.key_pressed) else None

    def stands() -> bool:
        return len(listener.samples) > 1 and judge.believed(listener.samples, listener.rest_ns())

    return listener.rest_ns() if listener.until(judge.NEVER_S + judge.RESTS_S, stands) else None
