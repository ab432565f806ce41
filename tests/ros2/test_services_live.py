"""The services and parameters, with the answers of the driver before, to the letter."""

from __future__ import annotations

import threading

from failstop.policy.settings import Settings
from failstop.ros2.mirrors import TABLE, values
from failstop_lab.trial import wait_for
from tests.ros2.scene import NODE, BridgeTrial
from tests.support.leases import TIMEOUT_S

BRIDGE = (
    *("--ros-args", "-p", "max_linear:=0.5", "-p", f"cmd_timeout:={TIMEOUT_S}", "-p", "gyro_noise_rad_s:=0.1"),
    *("-p", "imu_frame_id:=imu_left", "-p", "allowed_publishers:=['/nav', 'teleop']"),
)
REFUSED = (
    ("max_linear", 0.7, "change limits.vx_mps and limits.vy_mps in failstop's TOML file"),
    ("scan_timeout", 0.7, "change scan.timeout_s and scan.gate in failstop's TOML file"),
    ("gyro_noise_rad_s", 0.7, "read-only"),
    ("cmd_vel_type", "twist", "read once, at the start of the bridge"),
)


def test_enable_and_disable(scene: BridgeTrial) -> None:
    assert scene.eyes.call("enable", data=True) == (True, "enabled")
    assert scene.trial.robot.state.enabled
    assert scene.eyes.call("enable", data=True) == (True, "enabled")
    assert scene.eyes.call("enable", data=False) == (True, "disabled")
    assert not scene.trial.robot.state.enabled


def test_reset(scene: BridgeTrial) -> None:
    assert scene.eyes.call("reset_estop") == (True, "e-stop cleared (was: None); motion still disabled")
    button = scene.node("button")
    button.publish("estop", "std_msgs/msg/Bool", {"data": True}, hz=1.0)
    scene.state(lambda state: state["estop"] == "estop topic")
    scene.leave(button)
    found = (False, "")
    while not found[0]:  # while the stop is still being carried out
        found = scene.eyes.call("reset_estop")
        assert found[0] or found[1].startswith("refused: the stop is still being carried out (estop topic)")
    assert found == (True, "e-stop cleared (was: estop topic); motion still disabled")
    assert not scene.trial.robot.state.enabled


def test_a_request_that_may_have_waited_neither_enables_nor_resets(scene: BridgeTrial) -> None:
    """Its caller may have given up long ago, and a stop may have come since then."""
    done, text = scene.call_asleep("enable", data=True)
    assert not done
    assert text.startswith("refused: it may have waited for ")
    assert not scene.trial.robot.state.enabled
    scene.trial.robot.estop("hand near wheel")
    scene.state(lambda state: state["estop"])
    done, text = scene.call_asleep("reset_estop")
    assert not done
    assert text.startswith("refused: it may have waited for ")
    assert scene.trial.robot.state.estop
    wait_for("a reset that is asked for again", lambda: scene.eyes.call("reset_estop")[0])
    scene.enable()


def test_a_reset_does_not_clear_a_stop_that_came_while_it_waited(scene: BridgeTrial) -> None:
    """This is true of a short pause too, after which other requests are carried out."""
    stop = threading.Timer(0.1, scene.trial.robot.estop, ("hand near wheel",))
    stop.start()
    done, text = scene.call_asleep("reset_estop", for_s=0.4)
    stop.join()
    assert not done, text
    assert text.startswith("refused: ")
    assert scene.trial.robot.state.estop


def test_a_request_that_may_have_waited_still_disables_and_stops(scene: BridgeTrial) -> None:
    scene.enable()
    assert scene.call_asleep("enable", data=False) == (True, "disabled")
    assert not scene.trial.robot.state.enabled
    assert scene.call_asleep("stop")[0]
    assert scene.trial.robot.state.estop


def test_stop_tells_its_three_levels(scene: BridgeTrial) -> None:
    scene.eyes.call("enable", data=True)
    done, text = scene.eyes.call("stop")
    assert done
    assert text.startswith("stop latched (stop service): written after ")
    assert "acknowledged after " in text
    assert scene.trial.robot.state.estop
    done, text = scene.eyes.call("stop")
    assert done
    assert text.startswith("stop latched (stop service): written after ")
    assert text.endswith("; this stop was latched before the request")


def test_a_stop_is_no_success_once_the_cable_is_out(scene: BridgeTrial) -> None:
    """Whatever the stop that is latched already has proved."""
    scene.trial.robot.estop("hand near wheel")
    scene.state(lambda state: state["estop"] and state["last_stop"]["acknowledged_us"] is not None)
    scene.trial.board.unplug()
    try:
        done, text = scene.eyes.call("stop")
        assert not done
        assert text.startswith("stop latched (stop request: hand near wheel ")
        assert text.endswith(" is lost, so no stop reaches the board: use the POWER SWITCH")
    finally:
        scene.trial.board.replug()
        wait_for("the board", lambda: scene.trial.robot.state.device.link == "alive")


def test_parameters_show_the_settings(scene: BridgeTrial) -> None:
    names = [mirror.name for mirror in TABLE]
    told = scene.eyes.ask("get_parameters", node=NODE, names=names)["values"]
    fields = {1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 8: "double_array_value"}
    found = {name: value[fields[value["type"]]] for name, value in zip(names, told, strict=True)}
    assert found.pop("device") == scene.trial.link
    assert {**found, "device": "/dev/ttyACM0", "cmd_timeout": 0.3} == values(Settings().flat())
    assert found["cmd_timeout"] == TIMEOUT_S


def test_a_parameter_is_not_set_and_says_what_to_change(scene: BridgeTrial) -> None:
    for name, value, says in REFUSED:
        results = scene.eyes.ask("set_parameter", node=NODE, name=name, value=value)["results"]
        assert [result["successful"] for result in results] == [False], name
        assert says in results[0]["reason"]
    test_parameters_show_the_settings(scene)


def test_a_launch_file_that_wants_otherwise_is_told_of_by_name(scene: BridgeTrial) -> None:
    said = scene.bridge.said()
    assert (
        "parameter max_linear = 0.5 has no effect, because 0.2 is in force: change limits.vx_mps and limits.vy_mps in"
        in said
    )
    assert "parameter gyro_noise_rad_s = 0.1 has no effect, because 0.0012 is in force: remove it" in said
    assert "parameter cmd_timeout" not in said, "the same value is no contradiction"


def test_frames_are_the_bridges_own_parameters(scene: BridgeTrial) -> None:
    scene.eyes.hear("imu/data_raw", "sensor_msgs/msg/Imu")
    assert scene.eyes.next("imu/data_raw")["header"]["frame_id"] == "imu_left"


def test_who_is_on_the_list_of_publishers_drives_and_a_stranger_latches(scene: BridgeTrial) -> None:
    scene.scan()
    for who in ("nav", "teleop"):
        scene.enable()
        driver = scene.drive(who)
        scene.moving()
        scene.trial.robot.disable()
        scene.standing()
        scene.leave(driver)
        wait_for("its last command to be too old", lambda: not scene.trial.robot.state.sources)
    scene.trial.board.events()
    scene.drive("intruder")
    scene.state(lambda state: state["estop"] == "stranger on cmd_vel: /intruder (allowed: /nav, teleop)")
    assert not [event for event in scene.trial.board.events() if event.is_motion]
