"""The ROS 2 messages that an export is made of: their definitions, as an MCAP file carries them.

Each is the message's own fields and then, after a line of equals signs, those of every message within it (the MCAP
specification's `ros2msg` schema encoding).
"""

from __future__ import annotations

FIELDS = {
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "geometry_msgs/Vector3": "float64 x; float64 y; float64 z",
    "geometry_msgs/Quaternion": "float64 x 0; float64 y 0; float64 z 0; float64 w 1",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header; geometry_msgs/Twist twist",
    "sensor_msgs/Imu": "std_msgs/Header header; "
    "geometry_msgs/Quaternion orientation; float64[9] orientation_covariance; "
    "geometry_msgs/Vector3 angular_velocity; float64[9] angular_velocity_covariance; "
    "geometry_msgs/Vector3 linear_acceleration; float64[9] linear_acceleration_covariance",
    "sensor_msgs/JointState": "std_msgs/Header header; "
    "string[] name; float64[] position; float64[] velocity; float64[] effort",
    "sensor_msgs/BatteryState": "uint8 POWER_SUPPLY_STATUS_UNKNOWN=0; uint8 POWER_SUPPLY_STATUS_CHARGING=1; "
    "uint8 POWER_SUPPLY_STATUS_DISCHARGING=2; uint8 POWER_SUPPLY_STATUS_NOT_CHARGING=3; "
    "uint8 POWER_SUPPLY_STATUS_FULL=4; std_msgs/Header header; "
    "float32 voltage; float32 temperature; float32 current; float32 charge; "
    "float32 capacity; float32 design_capacity; float32 percentage; "
    "uint8 power_supply_status; uint8 power_supply_health; uint8 power_supply_technology; bool present; "
    "float32[] cell_voltage; float32[] cell_temperature; string location; string serial_number",
    "rcl_interfaces/Log": "byte DEBUG=10; byte INFO=20; byte WARN=30; byte ERROR=40; byte FATAL=50; "
    "builtin_interfaces/Time stamp; uint8 level; string name; string msg; string file; string function; uint32 line",
    "diagnostic_msgs/KeyValue": "string key; string value",
    "diagnostic_msgs/DiagnosticStatus": "byte OK=0; byte WARN=1; byte ERROR=2; byte STALE=3; "
    "byte level; string name; string message; string hardware_id; diagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header; diagnostic_msgs/DiagnosticStatus[] status",
}
LOG_LEVELS = {"info": 20, "notice": 20, "warning": 30, "error": 40, "critical": 50}


def definition(name: str) -> str:
    """The whole definition of a message."""
    return f"\n{'=' * 80}\n".join(_own(part) if part == name else f"MSG: {part}\n{_own(part)}" for part in _parts(name))


def _own(name: str) -> str:
    return FIELDS[name].replace("; ", "\n") + "\n"


def _parts(name: str) -> list[str]:
    """A message, and every one within it, once."""
    types = [field.split()[0].removesuffix("[]") for field in FIELDS[name].split("; ")]
    within = (part for kind in types if kind in FIELDS for part in _parts(kind))
    return list(dict.fromkeys((name, *within)))
