"""Export: an incident as MCAP with ROS 2 messages, for Foxglove, PlotJuggler, rosbag2.

/failstop/command      geometry_msgs/TwistStamped       the newest command of each tick in which one came
/failstop/gated        geometry_msgs/TwistStamped       what the gate made of it, each tick
/failstop/wheels       sensor_msgs/JointState           each motor frame and stop burst written; rad/s
/failstop/imu          sensor_msgs/Imu                  no orientation: its covariance begins with -1
/failstop/battery      sensor_msgs/BatteryState
/failstop/events       rcl_interfaces/Log               what people were told, and the cause
/failstop/processes    diagnostic_msgs/DiagnosticArray  how long each process was silent, 10 Hz
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from math import nan, tau
from typing import Any

from failstop.incidents import file, messages, signals
from failstop.incidents.file import IncidentError
from failstop.incidents.incident import Incident
from failstop.procs.telemetry.imu import RATE_VARIANCE
from failstop.shm import layout

NEEDS = "an export needs MCAP: pip install 'failstop[export]'"
FRAME = "base_link"
TOPICS = {
    "command": "geometry_msgs/TwistStamped",
    "gated": "geometry_msgs/TwistStamped",
    "wheels": "sensor_msgs/JointState",
    "imu": "sensor_msgs/Imu",
    "battery": "sensor_msgs/BatteryState",
    "events": "rcl_interfaces/Log",
    "processes": "diagnostic_msgs/DiagnosticArray",
}
NO_ORIENTATION = {
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "orientation_covariance": [-1.0, *[0.0] * 8],
}
UNKNOWN = [0.0] * 9
VARIANCE = [RATE_VARIANCE if index in (0, 4, 8) else 0.0 for index in range(9)]
WHEELS = [name.replace(" ", "_") for name in signals.WHEELS]

Message = tuple[int, str, dict[str, Any]]
"""When (CLOCK_MONOTONIC ns), topic, value but for its header."""


def save(incident: Incident, path: str) -> int:
    """Write the file whole or not at all; returns how many messages are in it. Raises IncidentError."""
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    series = (_gate(incident), _wheels(incident), _board(incident), _told(incident), _beats(incident))
    found = sorted((message for part in series for message in part), key=lambda message: message[0])
    made = BytesIO()
    writer: Any = Writer(made)
    schemas = {
        name: writer.register_msgdef(name.replace("/", "/msg/"), messages.definition(name))
        for name in dict.fromkeys(TOPICS.values())
    }
    counts = dict.fromkeys(TOPICS, 0)
    for ns, topic, value in found:
        counts[topic] += 1
        at_ns = incident.unix_ns(ns)
        stamp = dict(zip(("sec", "nanosec"), divmod(at_ns, 1_000_000_000), strict=True))
        whole = {"stamp": stamp, "header": {"stamp": stamp, "frame_id": FRAME}, **value}
        writer.write_message(f"/failstop/{topic}", schemas[TOPICS[topic]], whole, at_ns, at_ns, counts[topic])
    writer.finish()
    file.write_as(path, made.getvalue())
    return len(found)


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _gate(incident: Incident) -> Iterator[Message]:
    for tick in incident.ticks:
        for topic, (vx, vy, wz) in (("command", tick.command), ("gated", tick.velocity)):
            if topic == "gated" or tick.commands:
                yield tick.ns, topic, {"twist": {"linear": _vector(vx, vy, 0.0), "angular": _vector(0.0, 0.0, wz)}}


def _wheels(incident: Incident) -> Iterator[Message]:
    ids = signals.wheel_ids(incident)
    for write in incident.writes:
        if speeds := write.speeds_rps:
            velocity = [speeds[wire_id] * tau for wire_id in ids]
            yield write.ns, "wheels", {"name": WHEELS, "position": [], "velocity": velocity, "effort": []}


def _board(incident: Incident) -> Iterator[Message]:
    for sample in incident.imu:
        value: dict[str, Any] = {
            **NO_ORIENTATION,
            "angular_velocity": _vector(*sample.rate_radps),
            "angular_velocity_covariance": VARIANCE,
            "linear_acceleration": _vector(*sample.acceleration_mps2),
            "linear_acceleration_covariance": UNKNOWN,
        }
        yield sample.ns, "imu", value
    for ns, millivolts, plugged in incident.battery:
        value = dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity", "percentage"), nan)
        value |= {"voltage": millivolts / 1e3, "present": True}
        value |= {"power_supply_status": {"plugged": 1, "unplugged": 2}.get(plugged, 0)}
        value |= {"power_supply_health": 0, "power_supply_technology": 0, "location": "", "serial_number": ""}
        value |= {"cell_voltage": [], "cell_temperature": []}
        yield ns, "battery", value


def _told(incident: Incident) -> Iterator[Message]:
    rows = [(event.ns, event.level, event.kind, event.text) for event in incident.events]
    for ns, level, kind, text in (*rows, (incident.cause_ns, "error", "cause", incident.reason)):
        number = messages.LOG_LEVELS.get(level, messages.LOG_LEVELS["info"])
        value = {"level": number, "name": f"failstop.{kind}", "msg": text, "file": "", "function": "", "line": 0}
        yield ns, "events", value


def _beats(incident: Incident) -> Iterator[Message]:
    allowed_us = {process: signals.allowed_ns(incident, process) // 1000 for process in layout.PROCESSES}
    for ns, times in incident.beats:
        status = []
        for process, (silent_us, _) in zip(layout.PROCESSES, times, strict=True):
            late = silent_us > allowed_us[process]
            said = "silent for too long" if late else "beats"
            values = [{"key": "silent_ms", "value": f"{silent_us / 1e3:.3f}"}]
            row = {"level": 2 if late else 0, "name": process, "message": said, "hardware_id": incident.head["host"]}
            status.append({**row, "values": values})
        yield ns, "processes", {"status": status}
