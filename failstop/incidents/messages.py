"""The ROS 2 messages that an export is made of: their definitions, as an MCAP file carries them.

Each is the message's own fields and then, after a line of equals signs, those of every message within it (the MCAP
specification's `ros2msg` schema encoding).
"""

from __future__ import annotations

_NEXT = "\n" + "=" * 80 + "\nMSG: "
_TIME = f"{_NEXT}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER = f"{_NEXT}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_VECTOR = f"{_NEXT}geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"

TWIST_STAMPED = (
    "geometry_msgs/msg/TwistStamped",
    "std_msgs/Header header\ngeometry_msgs/Twist twist\n"
    f"{_HEADER}{_TIME}{_NEXT}geometry_msgs/Twist\n"
    f"geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{_VECTOR}",
)
IMU = (
    "sensor_msgs/msg/Imu",
    "std_msgs/Header header\n"
    "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    f"{_HEADER}{_TIME}{_NEXT}geometry_msgs/Quaternion\n"
    f"float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n{_VECTOR}",
)
JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    f"{_HEADER}{_TIME}",
)
BATTERY_STATE = (
    "sensor_msgs/msg/BatteryState",
    "uint8 POWER_SUPPLY_STATUS_UNKNOWN=0\nuint8 POWER_SUPPLY_STATUS_CHARGING=1\n"
    "uint8 POWER_SUPPLY_STATUS_DISCHARGING=2\nuint8 POWER_SUPPLY_STATUS_NOT_CHARGING=3\n"
    "uint8 POWER_SUPPLY_STATUS_FULL=4\n"
    "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n"
    "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\n"
    "uint8 power_supply_status\nuint8 power_supply_health\nuint8 power_supply_technology\nbool present\n"
    f"float32[] cell_voltage\nfloat32[] cell_temperature\nstring location\nstring serial_number\n{_HEADER}{_TIME}",
)
LOG = (
    "rcl_interfaces/msg/Log",
    "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
    "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n"
    f"{_TIME}",
)
DIAGNOSTICS = (
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
    f"{_HEADER}{_TIME}{_NEXT}diagnostic_msgs/DiagnosticStatus\n"
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
    "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    f"{_NEXT}diagnostic_msgs/KeyValue\nstring key\nstring value\n",
)
ALL = (TWIST_STAMPED, IMU, JOINT_STATE, BATTERY_STATE, LOG, DIAGNOSTICS)

LOG_LEVELS = {"info": 20, "notice": 20, "warning": 30, "error": 40, "critical": 50}
