"""Outward: a thread that publishes what the service reports. The thread also requests a stop if a second or a forbidden
node publishes cmd_vel, even a silent one.

The thread sleeps between its turns, because waiting for messages costs more.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from time import CLOCK_BOOTTIME, clock_gettime, monotonic_ns, sleep, time_ns
from typing import Any

from failstop.api.errors import FailstopError
from failstop.api.snapshot import Imu, Odometry, Pad
from failstop.api.state import State
from failstop.ros2 import contract, diagnostics, messages, report
from failstop.ros2.contract import OUTWARD, STATUS, TF, Topic
from failstop.ros2.fill import fill, type_of
from failstop.ros2.graph import Graph
from failstop.ros2.link import RobotLink
from failstop.ros2.pose import Pose
from failstop.ros2.scan import ScanLog
from failstop.ros2.shared import Shared
from failstop.ros2.stencil import Stencil, serializer

PERIOD_S = 0.018
"""The time between two turns, s. It is short enough to publish every odometry message (each 20 ms) separately, and long
enough for about two IMU samples, because waking up costs more than publishing."""
CLOCK_NS = 100_000_000
"""How often ROS's time is compared with this computer's clock. ROS's time may come from a simulator, or may be set."""
LEAST_NS = 1000
REPORT_NS = 100_000_000
DIAGNOSE_NS = 200_000_000
HEARD_NS = 500_000_000
"""How often to find out which topics have subscribers. A topic without subscribers is published only if that costs
little."""
SLOW_NS = 1_000_000_000
BATTERY_NS = SLOW_NS * 9 // 10
"""The shortest time between two published voltages. It is a little less than a second, because a board that reads one
each second is sometimes early."""
SUPERVISOR = "supervisor"
FROM = {
    "wheels": "the board's reports of the wheels",
    "commands": "the commands, because the board has not reported its wheels",
}
"""The words that people read for each Odometry.source."""


class Outward:
    """The publishers of the bridge, and what they published last."""

    def __init__(
        self, node: Any, qos: Any, link: RobotLink, shared: Shared, graph: Graph, settings: dict[str, Any]
    ) -> None:
        """`qos` makes rclpy's profile from a contract.Qos. `settings`: the bridge's own parameters."""
        self._node = node
        self._graph = graph
        self._link = link
        self._shared = shared
        self._frames = (settings["odom_frame_id"], settings["base_frame_id"])
        self._imu_frame = settings["imu_frame_id"]
        topics = [*OUTWARD, TF] if settings["publish_tf"] else list(OUTWARD)
        self._publishers: dict[str, Any] = {}
        self._messages: dict[str, Any] = {}
        self._stencils: dict[str, Stencil] = {}
        self._serialize = serializer()
        for topic in topics:
            self._make(topic, qos)
        self._constants()
        self._pose = Pose()
        self._wheels = messages.Wheels()
        self._scan_log = ScanLog(monotonic_ns())
        self._offset_ns = self._imu_ns = 0
        self._clock_ns = self._heard_ns = 0
        self._report_ns = self._diagnose_ns = self._slow_ns = 0
        self._stopped: bool | None = None
        self._begun = self._moves = self._ending = self._battery_seen = False
        self._battery_ns = -1
        """When the published voltage was read."""
        self._battery_published_ns = 0
        self._asked = 0
        self._heard: dict[str, bool] = {}
        """For each topic, True if it has a subscriber."""
        self._told: list[diagnostics.StatusMessage] = []
        self._deviations: tuple[float, ...] = ()
        self._odometry_from = ""
        self._joints: list[str] = []
        self._thread = threading.Thread(target=self._run, name="outward", daemon=True)

    def _make(self, topic: Topic, qos: Any) -> None:
        try:
            kind = type_of(topic.type)
        except FailstopError:
            if topic is not STATUS:
                raise
            return  # the package failstop_msgs is not built on this computer
        self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, qos(topic.qos))
        self._messages[topic.name] = kind()

    def _constants(self) -> None:
        variance = Imu._field_defaults["rate_variance"]
        self._keep(contract.IMU, messages.imu_constant(self._imu_frame, variance), messages.IMU_PLACES)
        self._keep(contract.ODOMETRY, messages.odometry_constant(*self._frames), messages.ODOMETRY_PLACES)
        self._keep(contract.GAMEPAD, messages.GAMEPAD_CONSTANT, messages.GAMEPAD_PLACES)
        fill(self._messages[contract.BATTERY.name], messages.BATTERY_CONSTANT)
        if TF.name in self._messages:
            transform = fill(
                type_of("geometry_msgs/msg/TransformStamped")(), messages.transform_constant(*self._frames)
            )
            self._keep(TF, {"transforms": [transform]}, messages.TRANSFORM_PLACES)

    def _keep(self, topic: Topic, constant: dict[str, Any], places: Sequence[str]) -> None:
        """Set the constant part of a topic's messages, and the places of the numbers that change."""
        message = fill(self._messages[topic.name], constant)
        self._stencils[topic.name] = Stencil(message, places, self._serialize)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """End the thread, so that nothing more is published."""
        self._ending = True
        self._thread.join(1.0)

    def _run(self) -> None:
        try:
            while not self._ending:
                sleep(PERIOD_S)
                self.turn(monotonic_ns())
        except BaseException as error:  # without this thread the bridge would drive without publishing anything
            self._shared.failed = error
            self._shared.ending = True
        self._link.close()

    def turn(self, now_ns: int) -> None:
        """Do everything that is due. The thread calls it each time it wakes up."""
        if now_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = now_ns
            # A simulator's time is 0 until /clock is received. Until then, this computer's clock is used.
            self._offset_ns = (self._node.get_clock().now().nanoseconds or time_ns()) - monotonic_ns()
        if now_ns - self._heard_ns >= HEARD_NS:
            self._heard_ns = now_ns
            self._heard = {name: bool(ends.get_subscription_count()) for name, ends in self._publishers.items()}
        try:
            run, samples = self._link.samples()
            for sample in samples:
                self._sample(self._pose.continued(run, sample) if isinstance(sample, Odometry) else sample)
        except FailstopError as error:
            self._lost(error)
        self._graph.ask(self._link, now_ns)
        if now_ns - self._report_ns >= REPORT_NS:
            self._report_ns = max(self._report_ns + REPORT_NS, now_ns - REPORT_NS // 2)
            self._publish_changes(now_ns, due=True)
        elif self._asked != self._shared.asked:
            self._publish_changes(now_ns)

    def _publish(self, topic: Topic, fields: dict[str, Any]) -> None:
        self._publishers[topic.name].publish(fill(self._messages[topic.name], fields))

    def _send(self, topic: Topic, values: messages.Values) -> None:
        """Publish a message with these numbers, if its topic has a subscriber."""
        if self._heard[topic.name]:
            self._publishers[topic.name].publish(self._stencils[topic.name].filled(values))

    def _sample(self, sample: object) -> None:
        if isinstance(sample, Imu):
            # Samples that arrived together have the same time, but filters divide by the time between samples. So
            # each time must be later than the one before, unless the clock was set back.
            ros_ns = sample.t_ns + self._offset_ns
            self._imu_ns = ros_ns if self._imu_ns - ros_ns > CLOCK_NS else max(ros_ns, self._imu_ns + LEAST_NS)
            self._send(contract.IMU, messages.imu(sample, self._imu_ns))
        elif isinstance(sample, Odometry):
            self._odometry(sample)
        elif isinstance(sample, Pad):
            self._send(contract.GAMEPAD, messages.gamepad(sample, sample.t_ns + self._offset_ns))

    def _odometry(self, sample: Odometry) -> None:
        ros_ns = sample.t_ns + self._offset_ns
        if sample.source != self._odometry_from:
            self._odometry_from = sample.source
            self._node.get_logger().info(f"{contract.ODOMETRY.name} comes from {FROM[sample.source]}")
        deviations = (sample.twist_std_mps, sample.twist_std_radps)
        if deviations != self._deviations:
            self._deviations = deviations
            self._keep(contract.ODOMETRY, messages.odometry_covariances(sample), messages.ODOMETRY_PLACES)
        self._send(contract.ODOMETRY, messages.odometry(sample, ros_ns))
        if TF.name in self._publishers:
            self._send(TF, messages.transform(sample, ros_ns))
        moves = bool(sample.vx_mps or sample.vy_mps or sample.wz_radps)
        if self._moves and not moves:  # the robot may have been stopped
            self._publish_changes(monotonic_ns())
        self._moves = moves

    def _lost(self, error: FailstopError) -> None:
        self._shared.problem = error
        self._shared.state = None
        self._wheels.update(None, monotonic_ns())

    def _publish_changes(self, now_ns: int, *, due: bool = False) -> None:
        """Publish what depends on the state. Without `due`, publish only a changed ~/emergency_stop."""
        self._asked = self._shared.asked
        state = self._state()
        if state:
            self._log(state, now_ns)
        stopped = report.latched(state)
        if stopped != self._stopped or (due and self._heard[contract.EMERGENCY_STOP.name]):
            self._stopped = stopped
            self._publish(contract.EMERGENCY_STOP, {"data": stopped})
        if due:
            self._report(state)
            self._diagnose(state, now_ns)

    def _state(self) -> State | None:
        try:
            state = self._link.state()
            if state.run != self._shared.run:
                self._shared.settings = self._link.call(lambda robot: robot.settings)
                self._shared.run = state.run
            self._shared.state = state
            return state
        except FailstopError as error:
            self._lost(error)
            return None

    def _log(self, state: State, now_ns: int) -> None:
        settings = self._shared.settings or {}
        self._wheels.update(state.wheels_radps, now_ns, state.steering_rad, state.turning, self._shared.run)
        timeout_s = float(settings["scan.timeout_s"])
        if line := self._scan_log.update(state.blocked, state.scan_age_s, timeout_s, now_ns):
            self._node.get_logger().warning(line)

    def _report(self, state: State | None) -> None:
        shared = self._shared
        ros_ns = monotonic_ns() + self._offset_ns
        if self._heard[contract.STATE.name] or not self._begun:
            known = (
                report.as_json(state, shared.publishers, shared.wrong)
                if state
                else report.without_state(shared.problem)
            )
            self._publish(contract.STATE, {"data": json.dumps(known)})
        if not self._begun:
            self._begun = True
            self._node.get_logger().info(f"first state {_age_s():.2f} s after the start")
        names, values = self._wheels.fields(ros_ns, state.arm if state else None)
        if names != self._joints:
            self._joints = names
            lengths = [0.0] * len(names)
            constant = {"name": names, "position": lengths, "velocity": lengths}
            self._keep(contract.JOINT_STATES, constant, messages.JOINT_PLACES)
        if names:
            self._send(contract.JOINT_STATES, values)
        if self._heard.get(STATUS.name):
            status = report.status(state) if state else report.status_without_state(shared.problem)
            # A package failstop_msgs that was built from older source lacks the newest fields.
            fields = {name: value for name, value in status.items() if hasattr(self._messages[STATUS.name], name)}
            self._publish(STATUS, {"stamp": messages.stamp(ros_ns), **fields})

    def _publish_battery(self, state: State | None, ros_ns: int, now_ns: int, *, slow: bool) -> None:
        """Publish each new reading once, with the time at which it was read. With `slow`, also publish that the battery
        is no longer reported, for example because the port is lost or no service is running. Otherwise subscribers
        would keep the last voltage."""
        self._battery_seen = True
        if not state or not state.battery_v or not state.is_current(state.ages.battery_s):
            if slow:
                self._publish(contract.BATTERY, messages.battery(None, "unknown", ros_ns))
        elif state.battery_ns != self._battery_ns and now_ns - self._battery_published_ns >= BATTERY_NS:
            self._battery_ns, self._battery_published_ns = state.battery_ns, now_ns
            read_ns = state.battery_ns + self._offset_ns if state.battery_ns else ros_ns
            self._publish(contract.BATTERY, messages.battery(state.battery_v, state.plugged, read_ns))

    def _diagnose(self, state: State | None, now_ns: int) -> None:
        slow = now_ns - self._slow_ns >= SLOW_NS
        if slow:
            self._slow_ns = max(self._slow_ns + SLOW_NS, now_ns - SLOW_NS // 2)
        ros_ns = monotonic_ns() + self._offset_ns
        if self._battery_seen or (state and state.battery_v):
            self._publish_battery(state, ros_ns, now_ns, slow=slow)
        if not self._heard[contract.DIAGNOSTICS.name] or not (slow or now_ns - self._diagnose_ns >= DIAGNOSE_NS):
            return
        self._diagnose_ns = now_ns
        shared = self._shared
        rows = diagnostics.statuses(
            self._node.get_name(), state, str(shared.problem), shared.sees, shared.wrong, shared.lacks
        )
        if slow or diagnostics.changed(self._told, rows):
            self._told = rows
            message = fill(type_of(contract.DIAGNOSTICS.type)(), {"header": {"stamp": messages.stamp(ros_ns)}})
            message.status = [_diagnostic(row) for row in rows]
            self._publishers[contract.DIAGNOSTICS.name].publish(message)


def _age_s() -> float:
    """How long ago this process was started, s."""
    with open("/proc/self/stat", encoding="utf-8", errors="replace") as file:
        born = int(file.read().rpartition(")")[2].split()[19])
    return clock_gettime(CLOCK_BOOTTIME) - born / os.sysconf("SC_CLK_TCK")


def _diagnostic(row: diagnostics.StatusMessage) -> Any:
    pair = type_of("diagnostic_msgs/msg/KeyValue")
    values = [fill(pair(), value) for value in row["values"]]
    status = type_of("diagnostic_msgs/msg/DiagnosticStatus")()
    # A ROS `byte` is a Python bytes object of length 1.
    return fill(status, {**row, "level": bytes([row["level"]]), "values": values})


__all__ = ["Outward"]
