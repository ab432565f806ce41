"""ROS as the tests have it, the stand-in or the real one: its environment, the bridge as a process, and nodes that do
what a test tells them."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.support.leases import LEASES

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
NODE = "/rosorin_board_driver"
TWIST = "geometry_msgs/msg/Twist"
STAMPED = "geometry_msgs/msg/TwistStamped"
SCAN = "sensor_msgs/msg/LaserScan"
BOOL = "std_msgs/msg/Bool"
FORWARD = {"linear": {"x": 0.2}}
SENSOR = {"reliable": False, "depth": 5}
DEADLINE_S = 20.0
WAIT_S = 0.5
"""A node is asked so seldom for what it has not heard yet."""
IMU_HZ = 20.0
"""Enough for most: each of the 110 samples a second of a real board wakes the bridge and three processes."""
REQUIRED = "FAILSTOP_ROS"
"""The setup file of a real ROS: `make ros2` sets it. Without it the stand-in alone is tried, whatever is installed."""
OVERLAY = "FAILSTOP_ROS_OVERLAY"
"""A setup file of further ROS packages, to source after ROS's own."""
RCLPY = "FAILSTOP_STANDIN_RCLPY"
"""Of which kind the stand-in's rclpy is: "before" its change #1469, or "since", as apt gives it today (the default)."""
_numbers = itertools.count()
_domains = itertools.count(os.getpid() % 40 + 1)


def new_name() -> str:
    return f"ros2-{os.getpid()}-{next(_numbers)}"


class Ros:
    """One of the two."""

    def __init__(self, kind: str, folder: Path) -> None:
        self.kind = kind
        self.real = kind == "real"
        self.environment = _real(folder) if self.real else _stand_in(folder)

    def run(self, *words: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(words, env=self.environment, capture_output=True, text=True, timeout=timeout_s)


def _stand_in(folder: Path) -> dict[str, str]:
    wire = Path(tempfile.mkdtemp(prefix="wire-", dir=folder))
    path = os.pathsep.join((str(HERE / "standin"), os.environ.get("PYTHONPATH", ""))).rstrip(os.pathsep)
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("ROS_", "AMENT_"))}
    return {**clean, "PYTHONPATH": path, "FAILSTOP_STANDIN": str(wire)}


def _real(folder: Path) -> dict[str, str]:
    required = os.environ.get(REQUIRED)
    if not required:
        pytest.skip("`make ros2` tries it on a real ROS")
    overlay = os.environ.get(OVERLAY, "/dev/null")
    script = f'. "{required}" && . "{overlay}" && env -0'
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=30, check=False)
    environment = {line.split("=", 1)[0]: line.split("=", 1)[1] for line in done.stdout.split("\0") if "=" in line}
    home = tempfile.mkdtemp(prefix="ros-home-", dir=folder)
    environment |= {"ROS_DOMAIN_ID": str(next(_domains)), "ROS_LOCALHOST_ONLY": "1", "ROS_LOG_DIR": home}
    probe = subprocess.run(
        [sys.executable, "-c", "import rclpy, sensor_msgs.msg"], env=environment, capture_output=True, check=False
    )
    if probe.returncode:
        lacks(f"{required} has no rclpy for this Python: {probe.stderr.decode(errors='replace')[-300:]}")
    return environment


def lacks(what: str) -> NoReturn:
    """A real ROS that can't be used: a failure where one is required, and a skip elsewhere."""
    (pytest.fail if os.environ.get(REQUIRED) else pytest.skip)(what)


class Node:
    """A talker of a name of its own."""

    def __init__(
        self,
        ros: Ros,
        name: str,
        *words: str,
        interpreter: tuple[str, ...] = (sys.executable,),
        environment: dict[str, str] | None = None,
    ) -> None:
        self.name = name
        self.sent_goals = False
        """A client of an action stays in the graph of a real ROS for as long as its process."""
        self.process = subprocess.Popen(
            [*interpreter, str(HERE / "talker.py"), name, *words],
            env={**ros.environment, **(environment or {})},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self._answer()

    def __enter__(self) -> Node:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], DEADLINE_S)
        line = self.process.stdout.readline() if ready else ""
        if not line:
            pytest.fail(f"{self.name} does not answer")
        found: dict[str, Any] = json.loads(line)
        return found

    def ask(self, what: str, **words: Any) -> dict[str, Any]:
        self.sent_goals |= what == "send_goal"
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"do": what, **words}) + "\n")
        return self._answer()

    def publish(self, topic: str, kind: str, fields: dict[str, Any], *, hz: float = 20.0, **words: Any) -> None:
        """Advertise, wait until somebody hears it, and publish again and again."""
        self.ask("advertise", topic=topic, type=kind, qos=words.pop("qos", None))
        if words.pop("match", True):
            wait_for(f"somebody to hear {topic}", lambda: self.ask("matched", topic=topic)["count"] > 0, DEADLINE_S)
        self.ask("repeat", topic=topic, fields=fields, hz=hz, **words)

    def hear(self, topic: str, kind: str, **qos: Any) -> None:
        self.ask("hear", topic=topic, type=kind, qos=qos)

    def take(self, topic: str, wait_s: float = 0.0) -> list[tuple[int, float, dict[str, Any]]]:
        """Messages since the last call, waiting so long for the first: monotonic ns, Unix time, the message."""
        found: list[tuple[int, float, dict[str, Any]]] = self.ask("take", topic=topic, wait_s=wait_s)["heard"]
        return found

    def next(self, topic: str, wanted: Any = lambda message: True, timeout_s: float = DEADLINE_S) -> dict[str, Any]:
        until_s = time.monotonic() + timeout_s
        last: dict[str, Any] | None = None
        while time.monotonic() < until_s:
            for _, _, message in self.take(topic, WAIT_S):
                last = message
                if wanted(message):
                    return message
        pytest.fail(f"no such message on {topic}; the last one: {last}")

    def call(self, service: str, **fields: Any) -> tuple[bool, str]:
        """A service of the bridge: (success, message)."""
        kind = "std_srvs/srv/SetBool" if fields else "std_srvs/srv/Trigger"
        found = self.ask("call", service=f"{NODE}/{service}", type=kind, fields=fields)
        assert "error" not in found, found
        return found["success"], found["message"]

    def become(self, name: str) -> None:
        """Be another node: the one before has left, as one does that ends in order."""
        self.ask("become", name=name)
        self.name = name

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        if self.process.poll() is None:
            assert self.process.stdin is not None
            self.process.stdin.close()
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.kill()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                pipe.close()


class Bridge:
    """`failstop ros2` as a process."""

    def __init__(self, ros: Ros, name: str, *words: str, environment: Mapping[str, str] | None = None) -> None:
        self._log = tempfile.NamedTemporaryFile("w+", prefix=f"{name}-ros2-", suffix=".log")  # noqa: SIM115
        self._command = [sys.executable, "-m", "failstop", "ros2", "--name", name, *words]
        self._environment = {**ros.environment, **(environment or {})}
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            self._command, env=self._environment, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log
        )

    def said(self) -> str:
        with open(self._log.name, encoding="utf-8", errors="replace") as file:
            return file.read()

    def send(self, number: int) -> None:
        os.kill(self.process.pid, number)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self, number: int = signal.SIGTERM) -> int:
        self.send(number)
        try:
            return self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.kill()
            pytest.fail(f"the bridge did not end: {self.said()}")

    def close(self) -> None:
        if self.process.poll() is None:
            self.send(signal.SIGCONT)
            self.end()
        self._log.close()


class BridgeTrial:
    """Board, service, bridge, and a node that looks on."""

    def __init__(
        self,
        ros: Ros,
        name: str,
        *words: str,
        settings: str = "",
        environment: Mapping[str, str] | None = None,
        imu_hz: float = IMU_HZ,
    ) -> None:
        """`settings`: of the service, besides its leases; `environment`: more of it, for the bridge."""
        self.ros = ros
        self._environment = environment
        fd, self._settings = tempfile.mkstemp(suffix=".toml")
        with open(fd, "w") as file:
            file.write(LEASES + settings)
        self.trial = Trial(name, ("--config", self._settings), imu_hz)
        self.words = words
        self.nodes: list[Node] = []
        self._idle: list[Node] = []
        """Processes of nodes that have ended, for the next ones."""

    def __enter__(self) -> BridgeTrial:
        self.trial.__enter__()
        try:
            self.bridge = Bridge(self.ros, self.trial.name, *self.words, environment=self._environment)
            self.eyes = self.node("eyes")
            self.eyes.hear(f"{NODE}/state", "std_msgs/msg/String")
            self.state(lambda state: state["state_age_ms"] is not None)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        for node in (*self.nodes, *self._idle):
            node.close()
        if hasattr(self, "bridge"):
            self.bridge.close()
        self.trial.close()
        if self._settings:
            os.unlink(self._settings)
            self._settings = ""

    def node(self, name: str) -> Node:
        """Make another node; it ends with the scene."""
        if self._idle:
            self.nodes.append(self._idle.pop())
            self.nodes[-1].become(name)
        else:
            self.nodes.append(Node(self.ros, name))
        return self.nodes[-1]

    def state(self, wanted: Any = lambda state: True) -> dict[str, Any]:
        """~/state from now on, once it is as wanted."""
        self.eyes.take(f"{NODE}/state")
        try:
            found = self.eyes.next(f"{NODE}/state", lambda message: wanted(json.loads(message["data"])))
        except pytest.fail.Exception as error:
            pytest.fail(f"{error}; the bridge ({self.bridge.process.poll()}) said: {self.bridge.said()[-2000:]}")
        state: dict[str, Any] = json.loads(found["data"])
        return state

    def call_asleep(self, service: str, *, for_s: float = 1.0, **fields: Any) -> tuple[bool, str]:
        """Call a service of the bridge, which is suspended for the first `for_s` of the call."""
        self.bridge.send(signal.SIGSTOP)
        waking = threading.Timer(for_s, self.bridge.send, (signal.SIGCONT,))
        waking.start()
        try:
            return self.eyes.call(service, **fields)
        finally:
            waking.join()

    def scan(self) -> Node:
        lidar = self.node("lidar")
        lidar.publish("scan", SCAN, {}, hz=20.0, qos=SENSOR)
        return lidar

    def drive(self, name: str = "nav", kind: str = TWIST, **words: Any) -> Node:
        driver = self.node(name)
        fields = {"twist": FORWARD} if kind == STAMPED else FORWARD
        driver.publish("cmd_vel", kind, fields, **words)
        return driver

    def enable(self) -> None:
        found = ("", "")

        def enabled() -> bool:
            nonlocal found
            done, text = self.eyes.call("enable", data=True)
            found = (str(done), text)
            return done

        wait_for(f"motion to be enabled, {found}", enabled)

    def driving(self, **words: Any) -> Node:
        """The driver of wheels that turn; the board's past is forgotten."""
        self.scan()
        self.enable()
        driver = self.drive(**words)
        self.moving()
        self.trial.board.events()
        return driver

    def moving(self) -> None:
        self.trial.board.wait_wheels(turning=True, timeout_s=DEADLINE_S)

    def standing(self) -> None:
        self.trial.board.wait_wheels(turning=False, timeout_s=DEADLINE_S)

    def fresh(self) -> None:
        """Return to the start: the bridge runs, nobody commands, nothing is latched, motion is disabled."""
        if self.bridge.process.poll() is not None:
            self.bridge.start()
        for node in [node for node in self.nodes if node is not self.eyes]:
            self.leave(node)
        self.state(lambda state: not state["publishers"] and state["state_age_ms"] is not None)
        wait_for("a reset to be taken", self.trial.reset)
        self.trial.robot.disable()
        self.state(lambda state: state["blocked"] == "disabled")
        wait_for("the last command to be too old", lambda: not self.trial.robot.state.sources)

    def leave(self, node: Node) -> None:
        self.nodes.remove(node)
        if node.process.poll() is None and not node.sent_goals:
            self._idle.append(node)
            node.ask("retire")
        else:
            node.close()

    @contextlib.contextmanager
    def another(self, *words: str, environment: Mapping[str, str] | None = None) -> Iterator[Bridge]:
        self.bridge.end()
        own, self.bridge = self.bridge, Bridge(self.ros, self.trial.name, *words, environment=environment)
        try:
            self.state(lambda state: state["state_age_ms"] is not None)
            yield self.bridge
        finally:
            self.bridge.close()
            self.bridge = own
