"""Export: writes an incident as an MCAP file with ROS 2 messages. Foxglove, PlotJuggler and rosbag2 can open it."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from math import tau
from typing import Any

from failstop import extras
from failstop.incidents import files
from failstop.incidents.files import IncidentError
from failstop.incidents.incident import Incident
from failstop.messages.records import RATE_VARIANCE

NEEDS = extras.missing("an export needs MCAP", "export")
SUFFIX = ".mcap"
FRAME = "base_link"
TOPICS = {
    "command": "geometry_msgs/TwistStamped",
    "gated": "geometry_msgs/TwistStamped",
    "wheels": "sensor_msgs/JointState",
    "measured": "sensor_msgs/JointState",
    "imu": "sensor_msgs/Imu",
    "events": "rcl_interfaces/Log",
}
"""The topics below /failstop, each with its message type.

- command: the newest command, or another that drives, for each tick of the gate in which a command arrived
- gated: the velocity that the gate decided, for each tick
- wheels: the wheel speeds of each motor frame and stop burst that was written (rad/s)
- measured: the wheel speeds that the board reported (rad/s)
- imu: the samples of the IMU
- events: the logged events, and the cause of the stop
"""
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
    "rcl_interfaces/Log": "byte DEBUG=10; byte INFO=20; byte WARN=30; byte ERROR=40; byte FATAL=50; "
    "builtin_interfaces/Time stamp; uint8 level; string name; string msg; string file; string function; uint32 line",
}
"""The fields of each message type."""
LOG_LEVELS = {"info": 20, "notice": 20, "warning": 30, "error": 40, "critical": 50}

END_OF_TIME_NS = 2**31 * 1_000_000_000
"""The end of the times that a message of ROS 2 can have, as Unix time in ns: the year 2038."""
CLOCK = "this computer's clock was wrong, and a message of ROS 2 can only have a time from 1970 to 2038"

Message = tuple[int, str, dict[str, Any]]
"""(time in CLOCK_MONOTONIC ns, topic, fields). The header, and fields that are zero, are left out."""


def save(incident: Incident, path: str) -> int:
    """Write an incident to `path`, completely or not at all. Returns the number of messages. Raises IncidentError."""
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    if not path.endswith(SUFFIX):
        raise IncidentError(f"{path}: the name must end in {SUFFIX}")
    found = sorted((*_motion(incident), *_board(incident), *_events(incident)), key=lambda message: message[0])
    offset_ns: int = incident.head["unix_minus_monotonic_ns"]
    if found and not 0 <= found[0][0] + offset_ns <= found[-1][0] + offset_ns < END_OF_TIME_NS:
        raise IncidentError(f"{incident.id} can't be exported: {CLOCK}")
    made = BytesIO()
    writer: Any = Writer(made)
    kinds = dict.fromkeys(TOPICS.values())
    schemas = {name: writer.register_msgdef(name.replace("/", "/msg/"), definition(name)) for name in kinds}
    for ns, topic, value in found:
        at_ns = ns + offset_ns
        stamp = dict(zip(("sec", "nanosec"), divmod(at_ns, 1_000_000_000), strict=True))
        whole = {"stamp": stamp, "header": {"stamp": stamp, "frame_id": FRAME}, **value}
        writer.write_message(f"/failstop/{topic}", schemas[TOPICS[topic]], whole, at_ns, at_ns)
    writer.finish()
    files.write_as(path, made.getvalue())
    return len(found)


def definition(name: str) -> str:
    """The complete definition of a message type, in the format `ros2msg` of the MCAP specification. It begins with the
    type's own fields. The types of nested messages follow, each after a line of equals signs."""
    parts = [name]
    for part in parts:  # the loop also visits the parts that it adds
        kinds = (field.split()[0].removesuffix("[]") for field in FIELDS[part].split("; "))
        parts += [kind for kind in dict.fromkeys(kinds) if kind in FIELDS and kind not in parts]
    texts = (f"MSG: {part}\n" * (part != name) + FIELDS[part].replace("; ", "\n") + "\n" for part in parts)
    return f"\n{'=' * 80}\n".join(texts)


def _motion(incident: Incident) -> Iterator[Message]:
    for tick in incident.ticks:
        for topic, (vx, vy, wz) in (("command", tick.command), ("gated", tick.velocity)):
            if topic == "gated" or tick.commands:
                yield tick.ns, topic, {"twist": {"linear": {"x": vx, "y": vy}, "angular": {"z": wz}}}
    names = [name.replace(" ", "_") for name in incident.wheels]
    for write in incident.writes:
        if speeds := write.speeds_rps:
            yield write.ns, "wheels", {"name": names, "velocity": [speed * tau for speed in speeds]}
    for ns, speeds in incident.measured:
        yield ns, "measured", {"name": names, "velocity": [speed * tau for speed in speeds]}


def _board(incident: Incident) -> Iterator[Message]:
    fixed = {
        # -1 means that there is no orientation.
        "orientation_covariance": [-1.0, *[0.0] * 8],
        "angular_velocity_covariance": [RATE_VARIANCE if index in (0, 4, 8) else 0.0 for index in range(9)],
        "linear_acceleration_covariance": [0.0] * 9,
    }
    for sample in incident.imu:
        acceleration, rate = (dict(zip("xyz", of, strict=True)) for of in (sample.acceleration_mps2, sample.rate_radps))
        yield sample.t_ns, "imu", {"angular_velocity": rate, "linear_acceleration": acceleration, **fixed}


def _events(incident: Incident) -> Iterator[Message]:
    rows = [(event.ns, event.level, event.kind, event.text) for event in incident.events]
    for ns, level, kind, text in (*rows, (incident.cause_ns, "error", "cause", incident.reason)):
        number = LOG_LEVELS.get(level, LOG_LEVELS["info"])
        yield ns, "events", {"level": number, "name": f"failstop.{kind}", "msg": text}
