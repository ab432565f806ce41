"""Begin and end of the bridge: killed, stopped, told to end; and a service that comes, goes and comes back."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import time
from pathlib import Path

import pytest

from failstop import Block, Robot
from failstop.messages.layout import CLIENT_SLOTS
from failstop_lab.trial import wait_for
from tests.ros2.scene import BOOL, DEADLINE_S, FORWARD, NODE, TWIST, Bridge, BridgeTrial, Node, Ros, new_name
from tests.support.amounts import amount
from tests.support.commands import failstop

RESTARTS = amount(2, 40)
SETTINGS = '[interlocks.ros2]\ntimeout_s = 0.3\nrefusal = "ROS 2 is away"\n'


def stopped(scene: BridgeTrial, since_ns: int) -> None:
    scene.trial.board.wait_for(lambda e: e.is_motor and not any(e.speeds) and e.arrival_ns > since_ns, DEADLINE_S)


def test_a_killed_bridge_stops_the_wheels_at_once_and_leaves_nothing(scene: BridgeTrial) -> None:
    driver = scene.driving()
    with open(f"/proc/{scene.bridge.process.pid}/maps", encoding="utf-8") as file:
        assert "/dev/shm/fastrtps" not in file.read()
    with open(f"/proc/{scene.bridge.process.pid}/limits", encoding="utf-8") as file:
        dump = next(line for line in file if line.startswith("Max core file size")).split()[4]
    assert int(dump) <= 1, "a crash leaves no dump, which would hold up the news of its death"
    robot = scene.trial.robot
    for restart in range(RESTARTS):
        killed_ns = time.monotonic_ns()
        scene.bridge.kill()
        stopped(scene, killed_ns)
        state = robot.state
        assert (state.enabled, state.estop) == (False, None), "as with any driver: motion is disabled, nothing latched"
        if not restart:
            told = re.compile(r"motion has been disabled since [^\n]*: ros2 \(pid \d+\) died after it had driven")
            assert told.search(str(robot.why())), "and not since its last command was too old"
        scene.trial.board.events()
        scene.bridge.start()
        scene.state(lambda state: state["blocked"] == "disabled" and state["publishers"] == ["/nav"])
        wait_for("it to command", lambda: robot.state.sources != ())
        assert not [event for event in scene.trial.board.events() if event.is_motion]
        scene.enable()
        wait_for("it to be held", lambda: robot.state.block is Block.HELD)
        driver.ask("rest", topic="cmd_vel")
        wait_for("its last command to be too old", lambda: not robot.state.sources)
        driver.ask("repeat", topic="cmd_vel", fields=FORWARD, hz=20.0)
        scene.moving()


def test_a_stopped_bridge_stops_the_wheels_and_passes_on_nothing_old(scene: BridgeTrial) -> None:
    driver = scene.driving()
    stopped_ns = time.monotonic_ns()
    scene.bridge.send(signal.SIGSTOP)
    stopped(scene, stopped_ns)
    driver.ask("rest", topic="cmd_vel")
    scene.trial.board.events()
    scene.bridge.send(signal.SIGCONT)
    scene.state()
    time.sleep(0.3)  # what waited would be written in this time
    assert not [event for event in scene.trial.board.events() if event.is_motion], "what waited in a queue is old"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_told_to_end(scene: BridgeTrial, number: int) -> None:
    scene.driving()
    told_ns = time.monotonic_ns()
    scene.bridge.send(number)
    stopped(scene, told_ns)
    assert scene.bridge.process.wait(10) == 0
    assert "Traceback" not in scene.bridge.said()
    why = str(scene.trial.robot.why())
    assert "died after it had driven" not in why, why


def test_the_namespace_and_remaps_are_roses(scene: BridgeTrial) -> None:
    words = ("--ros-args", "-r", "__ns:=/left", "-r", "cmd_vel:=/base/cmd_vel")
    bridge = Bridge(scene.ros, scene.trial.name, *words)
    try:
        node = scene.node("nav")
        wait_for("the topic", lambda: "/left/imu/data_raw" in node.ask("graph")["topics"])
        wait_for("the service", lambda: f"/left{NODE}/enable" in node.ask("graph")["services"])
        node.publish("/base/cmd_vel", TWIST, FORWARD)
        second = scene.node("other")
        second.publish("/base/cmd_vel", TWIST, FORWARD)
        wait_for("the latch", lambda: "multiple cmd_vel" in (scene.trial.robot.state.estop or ""))
    finally:
        bridge.close()


def test_a_stop_needs_no_client_slot(scene: BridgeTrial) -> None:
    """A bridge that can drive nothing goes on trying, and is asked to stop in the middle of that."""
    scene.bridge.kill()
    with contextlib.ExitStack() as stack:
        others = [stack.enter_context(Robot(scene.trial.name, client=f"other{n}")) for n in range(CLIENT_SLOTS)]
        scene.trial.leave()
        for robot in others:
            robot.say("here")
        scene.bridge.start()
        scene.drive()
        wait_for("a complaint", lambda: f"all {CLIENT_SLOTS} client slots of" in scene.bridge.said())
        scene.node("button").publish("estop", BOOL, {"data": True}, hz=1.0)
        wait_for("the stop", lambda: scene.trial.robot.state.cause is not None)
        done, text = scene.eyes.call("stop")
        assert done, text


def test_the_interlock_holds_while_one_at_most_publishes(scene: BridgeTrial) -> None:
    scene.driving()
    scene.bridge.send(signal.SIGSTOP)
    wait_for("motion to be disabled", lambda: not scene.trial.robot.state.enabled)
    assert "refused: ROS 2 is away; next: " in failstop("enable", "--name", scene.trial.name).stderr
    scene.bridge.send(signal.SIGCONT)
    scene.enable()


def test_a_service_that_was_started_anew_is_found_again(scene: BridgeTrial) -> None:
    """While there is none, no wheel turns in what the bridge publishes, as this board's wheels are not measured."""
    driver = scene.driving()
    scene.eyes.hear("joint_states", "sensor_msgs/msg/JointState")
    scene.eyes.next("joint_states", lambda message: all(message["velocity"][:4]))
    scene.trial.leave()
    scene.trial.service.kill()
    scene.state(lambda state: not state["enabled"])
    stood = scene.eyes.next("joint_states", lambda message: not any(message["velocity"][:4]))
    assert scene.eyes.next("joint_states")["position"] == stood["position"]
    driver.ask("rest", topic="cmd_vel")
    scene.trial.service.start()
    scene.enable()
    driver.ask("repeat", topic="cmd_vel", fields=FORWARD, hz=20.0)
    scene.moving()
    robot = scene.trial.robot
    wait_for("the gate to name it", lambda: any(client.name == "ros2" for client in robot.state.clients))


def test_without_a_service_it_waits_and_says_so(ros: Ros, tmp_path: Path) -> None:
    ros, name = Ros(ros.kind, tmp_path), new_name()
    bridge = Bridge(ros, name)
    try:
        with Node(ros, "eyes") as eyes:
            eyes.hear(f"{NODE}/state", "std_msgs/msg/String")
            eyes.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
            state = json.loads(eyes.next(f"{NODE}/state")["data"])
            assert (state["enabled"], state["state_age_ms"]) == (False, None)
            assert name in state["blocked"]
            done, text = eyes.call("enable", data=True)
            assert not done
            assert text.startswith("refused: no service named")
            row = eyes.next("/diagnostics")["status"][0]
            assert (row["name"], row["level"]) == (f"{NODE[1:]}: stop layer", 2)
    finally:
        bridge.close()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("-p", "cmd_vel_type:=twisted"), "one of auto, twist, stamped"),
        (("-p", "publish_tf:=maybe"), "parameter publish_tf: true or false is expected"),
    ],
)
def test_parameters_that_make_no_sense(ros: Ros, words: tuple[str, ...], says: str) -> None:
    bridge = Bridge(ros, new_name(), "--ros-args", *words)
    try:
        assert bridge.process.wait(20) == 1
        assert bridge.said().strip().splitlines()[-1].startswith("failstop: parameter ")
        assert says in bridge.said()
        assert "Traceback" not in bridge.said()
    finally:
        bridge.close()
