"""Topics that the bridge publishes: values, rates, stamps and frames, as the old driver's programs expect them."""

from __future__ import annotations

import itertools
import math
import statistics
import threading
import time
from typing import Any

import pytest

from failstop.lab.trial import wait_for
from failstop.ros2.link import RobotLink
from failstop.ros2.outward import Outward
from failstop.ros2.shared import Shared
from tests.ros2.scene import NODE, BridgeTrial

SECONDS = 2.0


def heard(scene: BridgeTrial, topic: str, kind: str, count: int, **qos: Any) -> list[tuple[int, float, dict[str, Any]]]:
    """Hear so many messages, from the first one on."""
    scene.eyes.hear(topic, kind, **qos)
    found: list[tuple[int, float, dict[str, Any]]] = []

    def enough() -> bool:
        found.extend(scene.eyes.take(topic))
        return len(found) >= count

    wait_for(f"{count} of {topic}", enough, 30.0)
    scene.eyes.ask("deaf", topic=topic)
    return found


def stamps(found: list[tuple[int, float, dict[str, Any]]]) -> list[float]:
    return [message["header"]["stamp"]["sec"] + message["header"]["stamp"]["nanosec"] / 1e9 for _, _, message in found]


def rate(times: list[float]) -> float:
    return (len(times) - 1) / (times[-1] - times[0])


def test_imu(scene: BridgeTrial) -> None:
    found = heard(scene, "imu/data_raw", "sensor_msgs/msg/Imu", 300, depth=100)
    times = stamps(found)
    assert times == sorted(set(times))
    assert rate(times) == pytest.approx(110, rel=0.05), "every sample"
    assert all(-0.02 < came - stamp < 1.0 for (_, came, _), stamp in zip(found, times, strict=True))
    message = found[-1][2]
    assert message["header"]["frame_id"] == "imu_link"
    assert message["orientation_covariance"] == [-1.0] + [0.0] * 8
    assert message["angular_velocity_covariance"][::4] == pytest.approx([0.0012**2] * 3)
    assert message["linear_acceleration"]["z"] == pytest.approx(9.8, abs=0.8)
    assert all(abs(message["angular_velocity"][axis]) < 0.2 for axis in "xyz")


def test_odometry(scene: BridgeTrial) -> None:
    scene.scan()
    scene.drive()
    scene.enable()
    scene.moving()
    scene.state(lambda state: state["body_vel"] == [0.2, 0.0, 0.0])
    found = heard(scene, "wheel/odom", "nav_msgs/msg/Odometry", 100, depth=100)
    times = stamps(found)
    between = [after - before for before, after in itertools.pairwise(times)]
    assert statistics.median(between) == pytest.approx(0.02, rel=0.1), "50 Hz, but for what a busy machine leaves out"
    first, last = found[0][2], found[-1][2]
    assert (first["header"]["frame_id"], first["child_frame_id"]) == ("odom", "base_link")
    way_m = last["pose"]["pose"]["position"]["x"] - first["pose"]["pose"]["position"]["x"]
    assert way_m == pytest.approx(0.2 * (times[-1] - times[0]), rel=0.1)
    assert last["twist"]["twist"]["linear"]["x"] == pytest.approx(0.2)
    pose, twist = last["pose"]["covariance"], last["twist"]["covariance"]
    assert [pose[at] for at in (0, 7, 35)] == [1000.0] * 3
    assert [twist[at] for at in (0, 7, 35)] == pytest.approx([0.05**2, 0.05**2, 0.2**2])
    turn = last["pose"]["pose"]["orientation"]
    assert turn["z"] ** 2 + turn["w"] ** 2 == pytest.approx(1.0)
    assert "/tf" not in scene.eyes.ask("graph")["topics"], "an EKF owns it"


def test_battery(scene: BridgeTrial) -> None:
    found = heard(scene, "battery", "sensor_msgs/msg/BatteryState", 3)
    assert rate(stamps(found)) == pytest.approx(1.0, rel=0.1)
    message = found[-1][2]
    assert 5 < message["voltage"] < 15
    assert all(math.isnan(message[field]) for field in ("percentage", "current", "charge"))
    assert message["power_supply_status"] == 0


def test_gamepad(scene: BridgeTrial) -> None:
    scene.eyes.hear("gamepad", "sensor_msgs/msg/Joy")

    def frame() -> bool:
        scene.trial.board.pad(0x0100, ly=127, hold=False)
        time.sleep(0.05)
        return bool(found := scene.eyes.take("gamepad")) and bool(messages.extend(found) or True)

    messages: list[tuple[int, float, dict[str, Any]]] = []
    wait_for("a frame", frame)
    message = messages[-1][2]
    assert message["axes"][:4] == pytest.approx([0.0, 1.0, 0.0, 0.0])
    assert len(message["axes"]) == 5
    assert message["buttons"] == [int(bit == 8) for bit in range(16)]


def test_joint_states(scene: BridgeTrial) -> None:
    scene.scan()
    scene.drive()
    scene.enable()
    scene.moving()
    scene.state(lambda state: state["body_vel"] == [0.2, 0.0, 0.0])
    found = heard(scene, "joint_states", "sensor_msgs/msg/JointState", 20)
    assert rate(stamps(found)) == pytest.approx(10, rel=0.1)
    first, last = found[0][2], found[-1][2]
    assert last["name"] == ["wheel_front_left", "wheel_rear_left", "wheel_front_right", "wheel_rear_right"]
    assert last["velocity"] == pytest.approx([0.2 / 0.04] * 4, rel=0.01), "forward turns every wheel forward"
    turned = [now - then for now, then in zip(last["position"], first["position"], strict=True)]
    seconds = stamps(found)[-1] - stamps(found)[0]
    assert turned == pytest.approx([5.0 * seconds] * 4, rel=0.1)


def test_state_and_emergency_stop_come_ten_times_a_second(scene: BridgeTrial) -> None:
    for topic, kind in (("state", "String"), ("emergency_stop", "Bool")):
        scene.eyes.take(f"{NODE}/state")
        found = heard(scene, f"{NODE}/{topic}", f"std_msgs/msg/{kind}", 30)
        times = [ns / 1e9 for ns, _, _ in found]
        assert rate(times) == pytest.approx(10, rel=0.15), topic
    scene.eyes.hear(f"{NODE}/state", "std_msgs/msg/String")


def test_typed_status(scene: BridgeTrial) -> None:
    if f"{NODE}/status" not in scene.eyes.ask("graph")["topics"]:
        pytest.skip("failstop_msgs is not built here")
    message = heard(scene, f"{NODE}/status", "failstop_msgs/msg/Status", 3)[-1][2]
    assert (message["enabled"], message["latched"], message["blocked"]) == (False, False, "disabled")
    assert message["link"] == "alive"


def test_diagnostics(scene: BridgeTrial) -> None:
    found = heard(scene, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 3)[-1][2]
    rows = {row["name"].partition(": ")[2]: row for row in found["status"]}
    assert {row["name"].partition(": ")[0] for row in found["status"]} == {NODE[1:]}
    processes = {f"process {name}" for name in ("supervisor", "port_owner", "gate", "telemetry", "stopper")}
    assert set(rows) == {"stop layer", *processes, "port", "link", "battery", "real-time rights", "ROS"}
    assert rows["stop layer"]["message"].startswith("STOPPED: blocked: disabled; next: `failstop enable")
    assert rows["stop layer"]["hardware_id"] == scene.trial.name
    assert rows["process gate"]["level"] == 0
    scene.trial.robot.estop("hand near wheel")
    scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    scene.eyes.next("/diagnostics", lambda message: message["status"][0]["level"] == 2)


def test_without_a_service_no_wheel_turns(scene: BridgeTrial) -> None:
    scene.scan()
    scene.drive()
    scene.enable()
    scene.moving()
    scene.eyes.hear("joint_states", "sensor_msgs/msg/JointState")
    scene.eyes.next("joint_states", lambda message: all(message["velocity"][:4]))
    scene.trial.leave()
    scene.trial.service.kill()
    stood = scene.eyes.next("joint_states", lambda message: not any(message["velocity"][:4]))
    later = scene.eyes.next("joint_states")
    assert later["position"] == stood["position"]


class Broken(Outward):
    """One whose turn fails."""

    def __init__(self, shared: Shared) -> None:
        self._shared, self._link, self._ending = shared, RobotLink("none"), False
        self._thread = threading.Thread(target=self._run)

    def turn(self, now_ns: int) -> None:
        raise RuntimeError("of rcl")


def test_the_end_of_the_thread_that_publishes_is_the_bridge_s() -> None:
    shared = Shared()
    outward = Broken(shared)
    outward.start()
    outward.end()
    assert shared.ending
    assert str(shared.failed) == "of rcl"
