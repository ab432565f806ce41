"""The contract line by line: what the robot's programs rely on, restated here as data, and what the tables say."""

from __future__ import annotations

import os

from failstop.api.errors import NoService, Refused
from failstop.messages.records import CAUSE, FOR_THE_LATCH
from failstop.policy import causes
from failstop.policy.settings import Settings
from failstop.ros2 import contract, mirrors, report, words
from failstop.ros2.contract import INWARD, OUTWARD, SERVICES, Qos
from tests.support import states

RELIABLE_10 = Qos(10, reliable=True, transient_local=False)
SENSOR_DATA = Qos(5, reliable=False, transient_local=False)
TRANSIENT_LOCAL = Qos(10, reliable=True, transient_local=True)

TOPICS_IN = {
    "cmd_vel": ("geometry_msgs/msg/Twist", RELIABLE_10),
    "scan": ("sensor_msgs/msg/LaserScan", SENSOR_DATA),
    "estop": ("std_msgs/msg/Bool", RELIABLE_10),
}
TOPICS_OUT = {
    "imu/data_raw": ("sensor_msgs/msg/Imu", RELIABLE_10, 110),
    "battery": ("sensor_msgs/msg/BatteryState", RELIABLE_10, 1),
    "wheel/odom": ("nav_msgs/msg/Odometry", RELIABLE_10, 50),
    "gamepad": ("sensor_msgs/msg/Joy", RELIABLE_10, 20),
    "joint_states": ("sensor_msgs/msg/JointState", RELIABLE_10, 10),
    "~/state": ("std_msgs/msg/String", RELIABLE_10, 10),
    "~/status": ("failstop_msgs/msg/Status", RELIABLE_10, 10),
    "~/emergency_stop": ("std_msgs/msg/Bool", TRANSIENT_LOCAL, 10),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", RELIABLE_10, 1),
}
TRIGGER = "std_srvs/srv/Trigger"
SERVICE_TYPES = {"~/enable": "std_srvs/srv/SetBool", "~/reset_estop": TRIGGER, "~/stop": TRIGGER}
STATE_KEYS = [
    *("enabled", "estop", "plugged", "arm_enabled", "arm_moving", "arm_pose", "servo_silent", "blocked", "body_vel"),
    *("scan_age", "gyro_bias_dps", "gyro_bias_tracking", "arm_holding", "pad_mode", "pad_joint", "auto_tuck_in_s"),
]
PARAMETERS: dict[str, object] = (
    {"device": "/dev/ttyACM0", "imu_frame_id": "imu_link", "odom_frame_id": "odom", "base_frame_id": "base_link"}
    | {"gyro_calib_seconds": 3.0, "gyro_calib_max_std_dps": 0.3, "estop_key": 1, "control_rate_hz": 50.0}
    | {"max_linear": 0.2, "max_angular": 1.0, "max_accel_linear": 0.5, "max_accel_angular": 2.0}
    | {"cmd_timeout": 0.3, "scan_timeout": 0.5, "accel_offset_g": [0.0] * 3, "accel_scale": [1.0] * 3}
    | {"gyro_bias_tau_s": 20.0, "gyro_bias_settle_s": 1.0, "gyro_bias_max_dev_dps": 0.5, "gyro_noise_rad_s": 0.0012}
    | {"odom_linear_std": 0.05, "odom_angular_std": 0.2, "odom_scale_x": 1.0, "odom_scale_y": 0.765}
    | {"pad_sounds": False, "drive_pan": -1, "cmd_vel_type": "auto", "allowed_publishers": [""], "publish_tf": False}
)


def test_topics_and_services() -> None:
    assert contract.NODE == "rosorin_board_driver"
    assert {topic.name: (topic.type, topic.qos) for topic in INWARD} == TOPICS_IN
    assert {topic.name: (topic.type, topic.qos, topic.hz) for topic in OUTWARD} == TOPICS_OUT
    assert {service.name: service.type for service in SERVICES} == SERVICE_TYPES
    twist, stamped = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
    assert {"auto": (twist, stamped), "twist": (twist,), "stamped": (stamped,)} == contract.COMMAND_TYPES


def test_parameters() -> None:
    own = {setting.name: setting.default for setting in contract.SETTINGS}
    shown = {**own, **mirrors.values(Settings().flat())}
    assert shown == PARAMETERS
    assert {name: type(value) for name, value in shown.items()} == {
        name: type(value) for name, value in PARAMETERS.items()
    }
    assert mirrors.values({**Settings().flat(), "scan.gate": "off"})["scan_timeout"] == 0.0


def test_state_has_every_key_in_its_order() -> None:
    keys = list(contract.STATE_KEYS)
    assert keys[: len(STATE_KEYS)] == STATE_KEYS
    assert list(report.as_json(states.state(), [], [])) == keys
    assert list(report.without_state(NoService("no service"))) == keys


def test_words_of_the_driver_before() -> None:
    assert words.ENABLED == "enabled"
    assert words.DISABLED == "disabled"
    words.asked("estop topic")
    own = causes.REQUESTED("estop topic", "ros2", os.getpid())
    for cause, text in ((causes.KEY(1), "key1"), (own, "estop topic")):
        latched = Refused(f"a stop is latched ({CAUSE})", cause, refused_for=FOR_THE_LATCH)
        assert words.refused(latched) == f"refused: e-stop latched ({text})"
        assert words.reset(cause) == f"e-stop cleared (was: {text}); motion still disabled"
    assert words.refused(Refused("arm is not in the drive pose")) == "refused: arm is not in the drive pose"
    assert words.refused(NoService("no service")) == "refused: no service"
    assert words.reset(None) == "e-stop cleared (was: None); motion still disabled"
    assert words.TOPIC_CAUSE == "estop topic"
    assert words.NO_ANSWER == "no answer from the gate in 0.5 s: wheels stopped"
    assert words.HELD.format(0.62) == "wheels held: no LiDAR scan for 0.6 s while commanded"
    assert words.RELEASED == "LiDAR scan back: wheels released"
