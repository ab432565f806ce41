"""Messages: samples and states as the fields of ROS messages, in plain dictionaries. Pure.

Each kind has what never changes (set once in a message that is used again and again) and what every message changes.
Times are ROS times in ns.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, nan, sin
from typing import Any

from failstop.api.samples import ImuSample, OdometrySample, PadSample
from failstop.api.snapshot import ArmState

Fields = dict[str, Any]

CHARGE = {"plugged": 1, "unplugged": 2, "unknown": 0}
"""power_supply_status: charging, discharging, unknown."""
FULL_AXIS = 127.0
BUTTONS = 16
WHEELS = ("wheel_front_left", "wheel_rear_left", "wheel_front_right", "wheel_rear_right")
"""The joints of the wheels, in the order of their motors."""
X, Y, YAW = 0, 7, 35
"""Where x, y and yaw have their variance in a covariance of 36."""


def stamp(ns: int) -> Fields:
    """builtin_interfaces/Time."""
    return {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}


def _xyz(values: Sequence[float]) -> Fields:
    return dict(zip("xyz", values, strict=True))


def imu_constant(frame: str, rate_variance: float) -> Fields:
    """What is the same in every Imu: there is no estimate of the orientation, and none of the acceleration's noise."""
    diagonal = [rate_variance if at % 4 == 0 else 0.0 for at in range(9)]
    return {
        "header": {"frame_id": frame},
        "orientation_covariance": [-1.0] + [0.0] * 8,
        "angular_velocity_covariance": diagonal,
    }


def imu(sample: ImuSample, ros_ns: int) -> Fields:
    """sensor_msgs/Imu."""
    return {
        "header": {"stamp": stamp(ros_ns)},
        "angular_velocity": _xyz(sample.rate_radps),
        "linear_acceleration": _xyz(sample.acceleration_mps2),
    }


BATTERY_CONSTANT: Fields = {
    "temperature": nan,
    "current": nan,
    "charge": nan,
    "capacity": nan,
    "design_capacity": nan,
    "percentage": nan,
    "present": True,
}


def battery(volts: float, plugged: str, ros_ns: int) -> Fields:
    """sensor_msgs/BatteryState."""
    return {
        "header": {"stamp": stamp(ros_ns)},
        "voltage": volts,
        "power_supply_status": CHARGE[plugged],
    }


def odometry_constant(frame: str, child: str) -> Fields:
    """What is the same in every Odometry."""
    return {"header": {"frame_id": frame}, "child_frame_id": child}


def odometry_covariances(sample: OdometrySample) -> Fields:
    """Of pose and twist; they change with the service's settings alone."""
    pose, twist = [0.0] * 36, [0.0] * 36
    for at in (X, Y, YAW):
        pose[at] = sample.pose_variance
    twist[X] = twist[Y] = sample.twist_std_mps**2
    twist[YAW] = sample.twist_std_radps**2
    return {"pose": {"covariance": pose}, "twist": {"covariance": twist}}


def _turn(th_rad: float) -> Fields:
    return {"z": sin(th_rad / 2), "w": cos(th_rad / 2)}


def odometry(sample: OdometrySample, ros_ns: int) -> Fields:
    """nav_msgs/Odometry."""
    position = {"x": sample.x_m, "y": sample.y_m}
    return {
        "header": {"stamp": stamp(ros_ns)},
        "pose": {"pose": {"position": position, "orientation": _turn(sample.th_rad)}},
        "twist": {
            "twist": {
                "linear": {"x": sample.vx_mps, "y": sample.vy_mps},
                "angular": {"z": sample.wz_radps},
            }
        },
    }


def transform(sample: OdometrySample, frame: str, child: str, ros_ns: int) -> Fields:
    """geometry_msgs/TransformStamped of the pose."""
    return {
        "header": {"stamp": stamp(ros_ns), "frame_id": frame},
        "child_frame_id": child,
        "transform": {"translation": {"x": sample.x_m, "y": sample.y_m}, "rotation": _turn(sample.th_rad)},
    }


def gamepad(sample: PadSample, ros_ns: int) -> Fields:
    """sensor_msgs/Joy."""
    return {
        "header": {"stamp": stamp(ros_ns)},
        "axes": [*(axis / FULL_AXIS for axis in sample.axes), float(sample.hat)],
        "buttons": [sample.buttons >> bit & 1 for bit in range(BUTTONS)],
    }


class Wheels:
    """The wheels' joints: how far each has turned, by what was commanded; positive turns forward."""

    def __init__(self) -> None:
        self._position_rad = [0.0] * 4
        self._velocity_radps = [0.0] * 4
        self._ns: int | None = None

    def follow(self, wheels_radps: Sequence[float], now_ns: int) -> None:
        """The speeds commanded from now on: State.wheels_radps."""
        if self._ns is not None:
            for at, speed_radps in enumerate(self._velocity_radps):
                self._position_rad[at] += speed_radps * (now_ns - self._ns) / 1e9
        self._ns = now_ns
        self._velocity_radps = list(wheels_radps)

    def fields(self, ros_ns: int, arm: ArmState | None = None) -> Fields:
        """sensor_msgs/JointState; `arm`: as in State.arm. A joint that was not read yet is left out; while it moves it
        is where it was sent."""
        joints = arm.joints if arm else {}
        found = {
            name: joint.angle_rad if joint.commanded_rad is None else joint.commanded_rad
            for name, joint in joints.items()
            if joint.angle_rad is not None
        }
        return {
            "header": {"stamp": stamp(ros_ns)},
            "name": [*WHEELS, *found],
            "position": [*self._position_rad, *found.values()],
            "velocity": [*self._velocity_radps, *([0.0] * len(found))],
        }
