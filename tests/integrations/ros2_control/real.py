"""A real controller manager of ros2_control with diff_drive_controller, started by the package's launch file. It drives
a robot of the simulated board through failstop's plugin, or through diffdrive_arduino at the guard port."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import signal
import subprocess
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType

from bench.guard_scene import GuardScene
from failstop_lab.controller_manager import CLIENT, PLUGIN, ROOT, run
from failstop_lab.trial import Stopped, Trial, TrialError, wait_for

from .scene import settings, stopped, urdf

ROS = os.environ.get("FAILSTOP_ROS", "")
"""The setup file of a real ROS: `make ros2-control` sets it."""
HURT = Path(__file__).resolve().parent / "hurt"
PLUGINS = ("failstop_ros2_control", "diffdrive_arduino")
"""The packages of the hardware interfaces. The second one is others' work, and need not be installed."""
PROGRAM = "ros2_control_node"
STARTS_S = 60.0
MPS = 0.1
PAUSE_S = 1.0
"""Twice the time after which diff_drive_controller commands zero (config/diff.yaml)."""
DRIVER = {
    "left_wheel_name": "left_wheel_joint",
    "right_wheel_name": "right_wheel_joint",
    "loop_rate": "30",
    "baud_rate": "57600",
    "timeout_ms": "1000",
    "enc_counts_per_rev": "3436",
    "pid_p": "20",
    "pid_d": "12",
    "pid_i": "0",
    "pid_o": "50",
}
"""Parameters of diffdrive_arduino as its own example has them."""


class Ros:
    """ROS with the packages of this repository built on it, on a domain of this test run that no other machine hears:
    whoever listens to the topic there may be a robot."""

    def __init__(self) -> None:
        """Build them; what is built is kept in build/. Raises TrialError with what was wrong."""
        folder = ROOT / "build" / "ros2_control" / f"real-{hashlib.sha256(ROS.encode()).hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self._build(folder)
        words = f". {ROS} && . {folder}/install/setup.bash && env -0"
        done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=True)
        own = {"ROS_DOMAIN_ID": str(os.getpid() % 20 + 81), "ROS_LOCALHOST_ONLY": "1"}
        self.environment = dict(line.split("=", 1) for line in done.stdout.split("\0") if "=" in line) | own
        self.humble = self.environment.get("ROS_DISTRO") == "humble"

    @staticmethod
    def _build(folder: Path) -> None:
        run("make", "--silent", "-C", CLIENT, f"BUILD={folder / 'client'}", f"PREFIX={folder / 'prefix'}", "install")
        built = f"--build-base {folder}/build --install-base {folder}/install"
        found = f"--base-paths {PLUGIN} {HURT} --cmake-args -DCMAKE_PREFIX_PATH={folder}/prefix"
        run("bash", "-c", f". {ROS} && colcon --log-base {folder}/log build {built} {found}")

    def lacks(self, plugin: str) -> str:
        """Why the hardware interface can't be tried; empty if it can."""
        prefixes = self.environment["AMENT_PREFIX_PATH"].split(os.pathsep)
        there = any(Path(each, "share/ament_index/resource_index/packages", plugin).exists() for each in prefixes)
        return "" if there else f"{plugin} is not built in this ROS"

    def run(self, *words: str, timeout_s: float = STARTS_S) -> str:
        """What a command prints. Raises subprocess.CalledProcessError, subprocess.TimeoutExpired."""
        return subprocess.run(
            words, env=self.environment, capture_output=True, text=True, check=True, timeout=timeout_s
        ).stdout


class Launched:
    """A context manager: a process of ROS in a session of its own, which is ended whole."""

    def __init__(self, ros: Ros, log: Path, *words: str) -> None:
        self.log = log
        home = log.with_name("home")  # the spawners of another run would wait for this one's otherwise
        with open(log, "wb") as out:
            self._process = subprocess.Popen(
                words,
                env={**ros.environment, "ROS_HOME": str(home), "ROS_LOG_DIR": str(home / "log")},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def __enter__(self) -> Launched:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number in (signal.SIGINT, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.killpg(self._process.pid, number)
                self._process.wait(10)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, and to nobody else."""
        self._process.send_signal(number)

    def child(self, name: str) -> int:
        """The pid of its child of that name; 0: it has none."""
        for pid in map(int, filter(str.isdigit, os.listdir("/proc"))):
            with contextlib.suppress(OSError):
                comm, _, rest = Path(f"/proc/{pid}/stat").read_text().partition("(")[2].rpartition(") ")
                state, parent, *_ = rest.split()
                if comm == name[:15] and int(parent) == self._process.pid and state not in "ZX":
                    return pid
        return 0


def described(plugin: str, service: str, port: str, orders: Path) -> str:
    """The example's URDF with this hardware interface, and with the sensor that hurts the manager."""
    robot = ElementTree.fromstring(urdf("diff", service=service))
    block = robot.find("ros2_control")
    assert block is not None
    if plugin == "diffdrive_arduino":
        for sensor in block.findall("sensor"):
            block.remove(sensor)
        hardware = block.find("hardware")
        assert hardware is not None
        _fill(hardware, "diffdrive_arduino/DiffDriveArduinoHardware", {**DRIVER, "device": port})
    hurt = ElementTree.SubElement(robot, "ros2_control", name="hurt", type="sensor")
    _fill(ElementTree.SubElement(hurt, "hardware"), "failstop_hurt/Hurt", {"orders": str(orders)})
    ElementTree.SubElement(ElementTree.SubElement(hurt, "sensor", name="hurt"), "state_interface", name="nothing")
    return ElementTree.tostring(robot, encoding="unicode")


def _fill(hardware: ElementTree.Element, plugin: str, parameters: Mapping[str, str]) -> None:
    hardware.clear()
    ElementTree.SubElement(hardware, "plugin").text = plugin
    for name, value in parameters.items():
        ElementTree.SubElement(hardware, "param", name=name).text = value


class Real:
    """A context manager: a service, a controller manager that is started again whenever it ends, and somebody who
    publishes a speed all the time."""

    def __init__(self, ros: Ros, plugin: str, folder: Path) -> None:
        self.ros, self.plugin, self.folder = ros, plugin, folder
        self._orders = folder / "orders"
        self._rest = contextlib.ExitStack()
        self._topic = "cmd_vel_unstamped" if ros.humble else "cmd_vel"

    def __enter__(self) -> Real:
        with contextlib.ExitStack() as rest:
            scene: GuardScene | None = None
            if self.plugin == "diffdrive_arduino":
                scene = GuardScene(self.folder, "arduino")
                self.trial = scene.trial
            else:
                name = f"ros2-real-{os.getpid()}"
                self.trial = Trial(name, settings(self.folder, "arduino"), imu_hz=20.0, kind="arduino")
            self.trial.service.ready_s = STARTS_S
            rest.enter_context(scene or self.trial)
            port = scene.path if scene else ""
            robot, controllers = self.folder / "base.urdf", self.folder / "controllers.yaml"
            robot.write_text(described(self.plugin, self.trial.name, port, self._orders))
            more = "    use_stamped_vel: false\n" if self.ros.humble else ""
            controllers.write_text((PLUGIN / "config" / "diff.yaml").read_text() + more)
            words = ("ros2", "launch", "failstop_ros2_control", "failstop.launch.py")
            files = (f"urdf:={robot}", f"controllers:={controllers}")
            self.launch = rest.enter_context(Launched(self.ros, self.folder / "launch", *words, *files))
            self.publisher = rest.enter_context(self._publisher())
            self._rest = rest.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._rest.close()

    def _publisher(self) -> Launched:
        twist = f"{{linear: {{x: {MPS}}}}}"
        kind, value = ("Twist", twist) if self.ros.humble else ("TwistStamped", f"{{header: auto, twist: {twist}}}")
        words = ("ros2", "topic", "pub", "--rate", "20", f"/base_controller/{self._topic}", f"geometry_msgs/msg/{kind}")
        return Launched(self.ros, self.folder / "publisher", *words, value)

    @property
    def logged(self) -> str:
        """What the launch and its processes said, without colours."""
        return re.sub(r"\x1b\[[0-9;]*m", "", self.launch.log.read_text(errors="replace"))

    def active(self) -> int:
        """How often the controller was activated so far."""
        return len(re.findall(r"activated base_controller", self.logged))

    def pid(self) -> int:
        """Of the controller manager; 0: none is there."""
        return self.launch.child(PROGRAM)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except (TrialError, TimeoutError) as error:
            why = self.trial.robot.why()
            raise TrialError(f"{error}\n{why}\n{self.trial.robot.state.clients}\n{self.logged[-6000:]}") from None

    def until_active(self, times: int) -> None:
        """Wait until the controller was activated so often. Raises TrialError with what was logged."""
        with self._told():
            wait_for("the controller to be active", lambda: self.active() >= times, STARTS_S)

    def drive(self) -> int:
        """The publisher pauses, a person enables motion, and the wheels turn; returns the controller manager's pid."""
        self.publisher.signal(signal.SIGSTOP)
        time.sleep(PAUSE_S)  # what commands a speed while motion is enabled is held until it has commanded zero
        try:
            self.trial.enable()
        finally:
            self.publisher.signal(signal.SIGCONT)
        with self._told():
            self.trial.board.wait_wheels(turning=True, timeout_s=STARTS_S)
        return self.pid()

    def order(self, what: str) -> None:
        """Let something happen in the loop of the controller manager (hurt/)."""
        made = self.folder / "order"
        made.write_text(what)
        made.rename(self._orders)

    def set_hardware(self, state: str) -> None:
        """Ask the controller manager to bring the base's hardware into a state."""
        number = {"unconfigured": 1, "inactive": 2, "active": 3}[state]
        self.call(
            "set_hardware_component_state",
            "SetHardwareComponentState",
            f"{{name: diff_base, target_state: {{id: {number}, label: {state}}}}}",
        )

    def switch(self, which: str) -> None:
        """Activate or deactivate the controller: `activate` or `deactivate`."""
        value = f"{{{which}_controllers: [base_controller], strictness: 2, timeout: {{sec: 5}}}}"
        self.call("switch_controller", "SwitchController", value)

    def call(self, service: str, kind: str, value: str) -> None:
        """Call a service of the controller manager. Raises TrialError if it refuses."""
        words = ("ros2", "service", "call", f"/controller_manager/{service}", f"controller_manager_msgs/srv/{kind}")
        if "ok=True" not in (answer := self.ros.run(*words, value)):
            raise TrialError(f"{service} {value}: {answer}\n{self.logged[-3000:]}")


def struck(real: Real, fault: str) -> Stopped:
    """What the board saw of a fault: a signal, or something that happens in the loop (hurt/)."""
    pid = real.pid()
    fault_ns = time.monotonic_ns()
    if fault.startswith("SIG"):
        os.kill(pid, signal.Signals[fault])
    else:
        real.order(fault)
    return stopped(real.trial, fault_ns)
