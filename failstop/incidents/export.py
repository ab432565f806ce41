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
NO_ORIENTATION = [-1.0, *[0.0] * 8]
UNKNOWN = [0.0] * 9
WHEELS = [name.replace(" ", "_") for name in signals.WHEELS]

Message = tuple[int, str, tuple[str, str], dict[str, Any]]
"""When (CLOCK_MONOTONIC ns), topic, definition, value."""


def save(incident: Incident, path: str) -> int:
    """Write the file whole or not at all; returns how many messages are in it. Raises IncidentError."""
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    found = sorted(_messages(incident), key=lambda message: message[0])
    made = BytesIO()
    writer: Any = Writer(made)
    schemas = {name: writer.register_msgdef(name, text) for name, text in messages.ALL}
    counts: dict[str, int] = {}
    for ns, topic, (name, _), value in found:
        counts[topic] = counts.get(topic, 0) + 1
        at_ns = incident.unix_ns(ns)
        writer.write_message(topic, schemas[name], value, log_time=at_ns, publish_time=at_ns, sequence=counts[topic])
    writer.finish()
    file.write_as(path, made.getvalue())
    return len(found)


def _messages(incident: Incident) -> Iterator[Message]:
    yield from _gate(incident)
    yield from _wheels(incident)
    yield from _board(incident)
    yield from _told(incident)
    yield from _beats(incident)


def _stamp(incident: Incident, ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(incident.unix_ns(ns), 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds}


def _header(incident: Incident, ns: int) -> dict[str, Any]:
    return {"stamp": _stamp(incident, ns), "frame_id": FRAME}


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _gate(incident: Incident) -> Iterator[Message]:
    for tick in incident.ticks:
        header = _header(incident, tick.ns)
        for topic, (vx, vy, wz), there in (
            ("/failstop/command", tick.command, tick.commands > 0),
            ("/failstop/gated", tick.velocity, True),
        ):
            if there:
                twist = {"linear": _vector(vx, vy, 0.0), "angular": _vector(0.0, 0.0, wz)}
                yield tick.ns, topic, messages.TWIST_STAMPED, {"header": header, "twist": twist}


def _wheels(incident: Incident) -> Iterator[Message]:
    ids = signals.wheel_ids(incident)
    for write in incident.writes:
        sort = signals.kind(write)
        if sort in (signals.MOTION, signals.ZERO, signals.STOP_BURST):
            speeds = (0.0,) * 4 if sort == signals.STOP_BURST else signals.speeds_rps(write)
            value = {
                "header": _header(incident, write.ns),
                "name": WHEELS,
                "position": [],
                "velocity": [speeds[wire_id] * tau for wire_id in ids],
                "effort": [],
            }
            yield write.ns, "/failstop/wheels", messages.JOINT_STATE, value


def _board(incident: Incident) -> Iterator[Message]:
    variance = [RATE_VARIANCE if index in (0, 4, 8) else 0.0 for index in range(9)]
    for sample in incident.imu:
        value: dict[str, Any] = {
            "header": _header(incident, sample.ns),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            "orientation_covariance": NO_ORIENTATION,
            "angular_velocity": _vector(*sample.rate_radps),
            "angular_velocity_covariance": variance,
            "linear_acceleration": _vector(*sample.acceleration_mps2),
            "linear_acceleration_covariance": UNKNOWN,
        }
        yield sample.ns, "/failstop/imu", messages.IMU, value
    for ns, millivolts, plugged in incident.battery:
        value = dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity", "percentage"), nan)
        value |= {"header": _header(incident, ns), "voltage": millivolts / 1e3, "present": True}
        value |= {"power_supply_status": {"plugged": 1, "unplugged": 2}.get(plugged, 0)}
        value |= {"power_supply_health": 0, "power_supply_technology": 0, "location": "", "serial_number": ""}
        value |= {"cell_voltage": [], "cell_temperature": []}
        yield ns, "/failstop/battery", messages.BATTERY_STATE, value


def _told(incident: Incident) -> Iterator[Message]:
    rows = [(event.ns, event.level, event.kind, event.text) for event in incident.events]
    rows.append((incident.cause_ns, "error", "cause", incident.reason))
    for ns, level, kind, text in rows:
        value = {
            "stamp": _stamp(incident, ns),
            "level": messages.LOG_LEVELS.get(level, messages.LOG_LEVELS["info"]),
            "name": f"failstop.{kind}",
            "msg": text,
            "file": "",
            "function": "",
            "line": 0,
        }
        yield ns, "/failstop/events", messages.LOG, value


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
        value = {"header": _header(incident, ns), "status": status}
        yield ns, "/failstop/processes", messages.DIAGNOSTICS, value
