"""Topics that the bridge publishes: values, rates, stamps and frames, as the old driver's programs expect them."""

from __future__ import annotations

import itertools
import math
import statistics
import threading
import time
from typing import Any

import pytest

from failstop.ros2 import contract
from failstop.ros2.link import RobotLink
from failstop.ros2.outward import Outward
from failstop.ros2.shared import Shared
from failstop_lab.trial import wait_for
from tests.ros2.scene import DEADLINE_S, NODE, BridgeTrial, Node

Heard = list[tuple[int, float, dict[str, Any]]]
IMU_HZ = 110.0
STILL = {
    "imu/data_raw": ("sensor_msgs/msg/Imu", 300),
    "battery": ("sensor_msgs/msg/BatteryState", 3),
    f"{NODE}/state": ("std_msgs/msg/String", 30),
    f"{NODE}/emergency_stop": ("std_msgs/msg/Bool", 30),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", 3),
}
ESTOPS = (contract.ESTOP, contract.ESTOP_LOSSY)
"""Without a transient local publisher of estop there is no lasting subscription, because ROS would warn of it."""
DRIVEN = {"wheel/odom": ("nav_msgs/msg/Odometry", 100), "joint_states": ("sensor_msgs/msg/JointState", 20)}


def heard(node: Node, topics: dict[str, tuple[str, int]]) -> dict[str, Heard]:
    """So many messages of each, from the first one on, all at the same time."""
    for topic, (kind, _) in topics.items():
        node.hear(topic, kind, depth=400)
    found: dict[str, Heard] = {topic: [] for topic in topics}
    until_s = time.monotonic() + DEADLINE_S
    while lacking := [topic for topic, (_, count) in topics.items() if len(found[topic]) < count]:
        assert time.monotonic() < until_s, {topic: len(found[topic]) for topic in lacking}
        for topic in topics:
            found[topic].extend(node.take(topic, 0.2 if topic in lacking else 0.0))
    return found


@pytest.fixture(scope="module")
def still(stage: BridgeTrial) -> dict[str, Heard]:
    stage.fresh()
    listener = stage.node("listener")
    found = heard(listener, STILL)
    stage.leave(listener)
    return found


@pytest.fixture(scope="module")
def driven(stage: BridgeTrial) -> dict[str, Heard]:
    stage.fresh()
    stage.driving()
    stage.state(lambda state: state["body_vel"] == [0.2, 0.0, 0.0])
    return heard(stage.node("listener"), DRIVEN)


def stamps(found: Heard) -> list[float]:
    return [message["header"]["stamp"]["sec"] + message["header"]["stamp"]["nanosec"] / 1e9 for _, _, message in found]


def rate(times: list[float]) -> float:
    return (len(times) - 1) / (times[-1] - times[0])


def usual_s(times: list[float]) -> float:
    """Between two: a busy machine holds up a few."""
    return statistics.median(after - before for before, after in itertools.pairwise(times))


def test_imu(still: dict[str, Heard]) -> None:
    found = still["imu/data_raw"]
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


def test_odometry(stage: BridgeTrial, driven: dict[str, Heard]) -> None:
    found = driven["wheel/odom"]
    times = stamps(found)
    assert usual_s(times) == pytest.approx(0.02, rel=0.1), "50 Hz"
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
    assert "/tf" not in stage.eyes.ask("graph")["topics"], "an EKF owns it"


def test_battery(still: dict[str, Heard]) -> None:
    found = still["battery"]
    assert rate(stamps(found)) == pytest.approx(1.0, rel=0.1)
    message = found[-1][2]
    assert 5 < message["voltage"] < 15
    assert all(math.isnan(message[field]) for field in ("percentage", "current", "charge"))
    assert message["power_supply_status"] == 0


def test_a_battery_of_a_silent_board_is_not_published_as_new(scene: BridgeTrial) -> None:
    scene.eyes.hear("battery", "sensor_msgs/msg/BatteryState")
    wait_for("a voltage", lambda: scene.eyes.take("battery"))
    scene.trial.board.silent(True)
    try:
        found: Heard = []
        wait_for(
            "no voltage",
            lambda: found.extend(scene.eyes.take("battery")) or any(not one[2]["present"] for one in found),
        )
        times = stamps([one for one in found if one[2]["present"]])
        assert len(set(times)) == len(times)
    finally:
        scene.trial.board.silent(False)


def test_a_battery_is_not_present_while_the_cable_is_out_or_no_service_runs(scene: BridgeTrial) -> None:
    def present(message: dict[str, Any]) -> bool:
        return bool(message["present"])

    def absent(message: dict[str, Any]) -> bool:
        return not message["present"] and math.isnan(message["voltage"])

    scene.eyes.hear("battery", "sensor_msgs/msg/BatteryState")
    scene.eyes.next("battery", present)
    scene.trial.board.unplug()
    try:
        scene.eyes.next("battery", absent)
    finally:
        scene.trial.board.replug()
    scene.eyes.next("battery", present)
    scene.trial.leave()
    scene.trial.service.kill()
    try:
        scene.eyes.next("battery", absent)
    finally:
        scene.trial.service.start()
    scene.eyes.next("battery", present)


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


def test_joint_states(driven: dict[str, Heard]) -> None:
    found = driven["joint_states"]
    assert usual_s(stamps(found)) == pytest.approx(0.1, rel=0.1)
    first, last = found[0][2], found[-1][2]
    assert last["name"] == ["wheel_front_left", "wheel_rear_left", "wheel_front_right", "wheel_rear_right"]
    assert last["velocity"] == pytest.approx([0.2 / 0.04] * 4, rel=0.01), "forward turns every wheel forward"
    turned = [now - then for now, then in zip(last["position"], first["position"], strict=True)]
    seconds = stamps(found)[-1] - stamps(found)[0]
    assert turned == pytest.approx([5.0 * seconds] * 4, rel=0.1)


def test_state_and_emergency_stop_come_ten_times_a_second(still: dict[str, Heard]) -> None:
    for topic in ("state", "emergency_stop"):
        times = [ns / 1e9 for ns, _, _ in still[f"{NODE}/{topic}"]]
        assert usual_s(times) == pytest.approx(0.1, rel=0.15), topic


def test_typed_status(scene: BridgeTrial) -> None:
    if f"{NODE}/status" not in scene.eyes.ask("graph")["topics"]:
        pytest.skip("failstop_msgs is not built here")
    topic = f"{NODE}/status"
    message = heard(scene.node("listener"), {topic: ("failstop_msgs/msg/Status", 1)})[topic][0][2]
    assert (message["enabled"], message["latched"], message["blocked"]) == (False, False, "disabled")
    assert message["link"] == "alive"


def test_diagnostics(still: dict[str, Heard], scene: BridgeTrial) -> None:
    found = still["/diagnostics"][-1][2]
    rows = {row["name"].partition(": ")[2]: row for row in found["status"]}
    assert {row["name"].partition(": ")[0] for row in found["status"]} == {NODE[1:]}
    processes = {f"process {name}" for name in ("supervisor", "port_owner", "gate", "telemetry", "stopper")}
    others = {"port", "link", "battery", "speeds", "real-time rights", "ROS"}
    assert set(rows) == {"stop layer", "wheels", *processes, *others}
    assert rows["stop layer"]["message"].startswith("STOPPED: blocked: disabled; next: `failstop enable")
    assert rows["stop layer"]["hardware_id"] == scene.trial.name
    assert rows["process gate"]["level"] == 0
    scene.trial.robot.estop("hand near wheel")
    scene.eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    scene.eyes.next("/diagnostics", lambda message: message["status"][0]["level"] == 2)


def test_the_running_bridge_offers_what_the_contract_says(scene: BridgeTrial) -> None:
    graph = scene.eyes.ask("graph")
    for service in contract.SERVICES:
        assert graph["services"][service.name.replace("~", NODE)] == [service.type]
    for topic in (*contract.INWARD, *contract.OUTWARD):
        name = topic.name.replace("~", NODE)
        name = name if name.startswith("/") else f"/{name}"
        if topic is contract.STATUS and name not in graph["topics"]:
            continue  # failstop_msgs is not built here
        of = "subscriptions" if topic in contract.INWARD else "publishers"
        wanted = [
            {"node": NODE, "type": each.type, "reliable": each.qos.reliable, "lasting": each.qos.transient_local}
            for each in ([*ESTOPS] if topic is contract.ESTOP else [topic])
        ]
        ends: list[dict[str, Any]] = []
        until_s = time.monotonic() + DEADLINE_S
        while len(ends) < len(wanted) and time.monotonic() < until_s:
            ends = [end for end in scene.eyes.ask("ends", topic=name, of=of)["ends"] if end["node"] == NODE]
        assert sorted(ends, key=lambda end: (not end["reliable"], end["lasting"])) == wanted, name


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
