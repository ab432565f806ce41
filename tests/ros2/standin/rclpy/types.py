"""Messages and services of the stand-in, as classes made from short definitions, and as modules to import from.

As in ROS, a field takes its own type only: an int is no float.
"""

from __future__ import annotations

import os
import re
import sys
from types import ModuleType
from typing import ClassVar

DEFINITIONS = """
builtin_interfaces/msg/Time: int sec, int nanosec
builtin_interfaces/msg/Duration: int sec, int nanosec
std_msgs/msg/Header: builtin_interfaces/msg/Time stamp, string frame_id
std_msgs/msg/String: string data
std_msgs/msg/Bool: bool data
geometry_msgs/msg/Vector3: float x, float y, float z
geometry_msgs/msg/Point: float x, float y, float z
geometry_msgs/msg/Quaternion: float x, float y, float z, float w
geometry_msgs/msg/Twist: geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular
geometry_msgs/msg/TwistStamped: std_msgs/msg/Header header, geometry_msgs/msg/Twist twist
geometry_msgs/msg/Pose: geometry_msgs/msg/Point position, geometry_msgs/msg/Quaternion orientation
geometry_msgs/msg/PoseWithCovariance: geometry_msgs/msg/Pose pose, float[36] covariance
geometry_msgs/msg/TwistWithCovariance: geometry_msgs/msg/Twist twist, float[36] covariance
geometry_msgs/msg/Transform: geometry_msgs/msg/Vector3 translation, geometry_msgs/msg/Quaternion rotation
geometry_msgs/msg/TransformStamped: std_msgs/msg/Header header, string child_frame_id, \
geometry_msgs/msg/Transform transform
sensor_msgs/msg/LaserScan: std_msgs/msg/Header header, float angle_min, float angle_max, float[] ranges
sensor_msgs/msg/PointCloud2: std_msgs/msg/Header header
sensor_msgs/msg/Imu: std_msgs/msg/Header header, geometry_msgs/msg/Quaternion orientation, \
float[9] orientation_covariance, geometry_msgs/msg/Vector3 angular_velocity, float[9] angular_velocity_covariance, \
geometry_msgs/msg/Vector3 linear_acceleration, float[9] linear_acceleration_covariance
sensor_msgs/msg/BatteryState: std_msgs/msg/Header header, float voltage, float temperature, float current, \
float charge, float capacity, float design_capacity, float percentage, int power_supply_status, bool present
sensor_msgs/msg/Joy: std_msgs/msg/Header header, float[] axes, int[] buttons
sensor_msgs/msg/JointState: std_msgs/msg/Header header, string[] name, float[] position, float[] velocity, \
float[] effort
trajectory_msgs/msg/JointTrajectoryPoint: float[] positions, float[] velocities, float[] accelerations, \
builtin_interfaces/msg/Duration time_from_start
trajectory_msgs/msg/JointTrajectory: std_msgs/msg/Header header, string[] joint_names, \
trajectory_msgs/msg/JointTrajectoryPoint[] points
unique_identifier_msgs/msg/UUID: int[16] uuid
nav_msgs/msg/Odometry: std_msgs/msg/Header header, string child_frame_id, geometry_msgs/msg/PoseWithCovariance pose, \
geometry_msgs/msg/TwistWithCovariance twist
tf2_msgs/msg/TFMessage: geometry_msgs/msg/TransformStamped[] transforms
diagnostic_msgs/msg/KeyValue: string key, string value
diagnostic_msgs/msg/DiagnosticStatus: byte level, string name, string message, string hardware_id, \
diagnostic_msgs/msg/KeyValue[] values
diagnostic_msgs/msg/DiagnosticArray: std_msgs/msg/Header header, diagnostic_msgs/msg/DiagnosticStatus[] status
rcl_interfaces/msg/ParameterDescriptor: string name, string description, bool dynamic_typing, bool read_only
rcl_interfaces/msg/SetParametersResult: bool successful, string reason
rcl_interfaces/msg/ParameterValue: int type, bool bool_value, int integer_value, float double_value, \
string string_value, float[] double_array_value, string[] string_array_value
rcl_interfaces/msg/Parameter: string name, rcl_interfaces/msg/ParameterValue value
failstop_msgs/msg/Status: builtin_interfaces/msg/Time stamp, bool enabled, string blocked, bool latched, \
string estop, string driver, float state_age_s, float scan_age_s, string link, string last_stop, \
float last_stop_written_s, float last_stop_acknowledged_s, float last_stop_observed_s
std_srvs/srv/SetBool: bool data -> bool success, string message
std_srvs/srv/Trigger: -> bool success, string message
rcl_interfaces/srv/GetParameters: string[] names -> rcl_interfaces/msg/ParameterValue[] values
rcl_interfaces/srv/SetParameters: rcl_interfaces/msg/Parameter[] parameters -> \
rcl_interfaces/msg/SetParametersResult[] results
"""
ACTIONS = """
control_msgs/action/FollowJointTrajectory: trajectory_msgs/msg/JointTrajectory trajectory \
-> int error_code, string error_string -> std_msgs/msg/Header header, string[] joint_names, \
trajectory_msgs/msg/JointTrajectoryPoint desired, trajectory_msgs/msg/JointTrajectoryPoint actual, \
trajectory_msgs/msg/JointTrajectoryPoint error
"""
CONSTANTS = {"control_msgs/action/FollowJointTrajectory": {"SUCCESSFUL": 0, "PATH_TOLERANCE_VIOLATED": -4}}
"""Of an action's result."""
WITHOUT = "FAILSTOP_STANDIN_WITHOUT"
"""A package that is not installed."""
UUID = "unique_identifier_msgs/msg/UUID"
PLAIN = {"int": (int, 0), "float": (float, 0.0), "bool": (bool, False), "string": (str, ""), "byte": (bytes, b"\0")}
TYPES: dict[str, type] = {}
ONE = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}
"""Defaults that are not zero."""


class Message:
    """The base of all; `_fields` maps a field to its type."""

    _fields: ClassVar[dict[str, str]] = {}
    _name: ClassVar[str] = ""

    def __init__(self, **values: object) -> None:
        for field, kind in self._fields.items():
            object.__setattr__(self, field, ONE.get(self._name, {}).get(field, _default(kind)))
        for field, value in values.items():
            setattr(self, field, value)

    def __setattr__(self, field: str, value: object) -> None:
        if field not in self._fields:
            raise AttributeError(f"{self._name} has no field {field!r}")
        kind = self._fields[field]
        assert _fits(kind, value), f"The {field!r} field must be of type {kind!r}, not {value!r}"
        object.__setattr__(self, field, value)

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        return dict(cls._fields)


def _default(kind: str) -> object:
    if found := re.fullmatch(r"(.+)\[(\d*)\]", kind):
        return [_default(found[1])] * int(found[2] or 0)
    return PLAIN[kind][1] if kind in PLAIN else TYPES[kind]()


def _fits(kind: str, value: object) -> bool:
    if found := re.fullmatch(r"(.+)\[(\d*)\]", kind):
        return (
            isinstance(value, (list, tuple))
            and len(value) in (int(found[2] or len(value)), len(value) if not found[2] else -1)
            and all(_fits(found[1], item) for item in value)
        )
    wanted = PLAIN[kind][0] if kind in PLAIN else TYPES[kind]
    return isinstance(value, wanted) and not (wanted is int and isinstance(value, bool))


def to_plain(message: Message) -> dict[str, object]:
    return {field: _plain(getattr(message, field)) for field in message._fields}


def _plain(value: object) -> object:
    if isinstance(value, Message):
        return to_plain(value)
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def from_plain(kind: str, fields: dict[str, object]) -> Message:
    message = TYPES[kind]()
    for field, value in fields.items():
        object.__setattr__(message, field, _built(message._fields[field], value))
    return message


def _built(kind: str, value: object) -> object:
    base = kind.partition("[")[0]
    if base in PLAIN:
        return value
    return [from_plain(base, item) for item in value] if base != kind else from_plain(kind, value)


def _module(name: str) -> ModuleType:
    if name not in sys.modules:
        sys.modules[name] = ModuleType(name)
        parent, _, last = name.rpartition(".")
        if parent:
            setattr(_module(parent), last, sys.modules[name])
        else:
            sys.modules[name].__path__ = []
    return sys.modules[name]


def _fields(text: str) -> dict[str, str]:
    pairs = [part.split() for part in text.split(",") if part.strip()]
    return {field: kind for kind, field in pairs}


def _make(name: str, fields: str) -> type:
    made = type(name.rpartition("/")[2], (Message,), {"_fields": _fields(fields), "_name": name})
    TYPES[name] = made
    return made


def _service(name: str, request: str, response: str) -> type:
    parts = {"Request": _make(f"{name}_Request", request), "Response": _make(f"{name}_Response", response)}
    return type(name.rpartition("/")[2], (), {**parts, "_name": name})


def _action(name: str, text: str) -> type:
    texts = dict(zip(("Goal", "Result", "Feedback"), text.split("->"), strict=True))
    parts = {part: _make(f"{name}_{part}", fields) for part, fields in texts.items()}
    for constant, value in CONSTANTS.get(name, {}).items():
        setattr(parts["Result"], constant, value)
    inner = {
        "FeedbackMessage": _make(f"{name}_FeedbackMessage", f"{UUID} goal_id, {name}_Feedback feedback"),
        "send_goal": _service(f"{name}_SendGoal", f"{UUID} goal_id, {name}_Goal goal", "bool accepted"),
        "get_result": _service(f"{name}_GetResult", f"{UUID} goal_id", f"int status, {name}_Result result"),
        "cancel_goal": _service(f"{name}_CancelGoal", f"{UUID} goal_id", f"{UUID}[] goals_canceling"),
    }
    return type(name.rpartition("/")[2], (), {**parts, "Impl": type("Impl", (), inner), "_name": name})


def install() -> None:
    for line in DEFINITIONS.strip().splitlines():
        name, _, text = line.partition(":")
        package, kind, last = name.split("/")
        request, arrow, response = text.partition("->")
        made = _service(name, request, response) if arrow else _make(name, text)
        setattr(_module(f"{package}.{kind}"), last, made)
    for line in ACTIONS.strip().splitlines():
        name, _, text = line.partition(":")
        package, kind, last = name.split("/")
        if package != os.environ.get(WITHOUT):
            setattr(_module(f"{package}.{kind}"), last, _action(name, text))


install()
