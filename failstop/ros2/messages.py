"""Messages: turns samples and states into the fields of ROS messages, as plain values. Pure.

Each kind of message has a constant part and a changing part. The constant part is set once, in a message that is used
again and again. For kinds that are sent often, the changing part is numbers for the places of a stencil (stencil.py).
Times are ROS times in ns.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, nan, sin
from typing import Any

from failstop.api import snapshot
from failstop.api.snapshot import ArmState, Imu, Odometry, Pad

Fields = dict[str, Any]
Values = tuple[Sequence[float], ...]
"""The numbers for the places of a stencil, in the order of the places."""

CHARGE = {"plugged": 1, "unplugged": 2, "unknown": 0}
"""The values of power_supply_status: charging, discharging, unknown."""
FULL_AXIS = 127.0
BUTTONS = 16
X, Y, YAW = 0, 7, 35
"""Where the variances of x, y and yaw are in a covariance of 36 numbers."""


def stamp(ns: int) -> Fields:
    """A time as the fields of a builtin_interfaces/Time."""
    return {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}


def _stamped(ns: int) -> tuple[int, int]:
    """A time as two numbers for a stencil: seconds and nanoseconds."""
    return divmod(ns, 1_000_000_000)


def imu_constant(frame: str, rate_variance: float) -> Fields:
    """The fields that are the same in all Imu messages. The orientation is marked as missing, and the acceleration's
    noise as unknown."""
    diagonal = [rate_variance if at % 4 == 0 else 0.0 for at in range(9)]
    return {
        "header": {"frame_id": frame},
        "orientation_covariance": [-1.0] + [0.0] * 8,
        "angular_velocity_covariance": diagonal,
    }


IMU_PLACES = ("header.stamp", "angular_velocity", "linear_acceleration")


def imu(sample: Imu, ros_ns: int) -> Values:
    """The changing values of a sensor_msgs/Imu."""
    return _stamped(ros_ns), sample.rate_radps, sample.acceleration_mps2


BATTERY_CONSTANT: Fields = {
    "temperature": nan,
    "current": nan,
    "charge": nan,
    "capacity": nan,
    "design_capacity": nan,
    "percentage": nan,
}


def battery(volts: float | None, plugged: str, ros_ns: int) -> Fields:
    """The fields of a sensor_msgs/BatteryState. `volts` is None if nobody knows the battery's voltage at present. Then
    nobody knows whether it is charged either."""
    return {
        "header": {"stamp": stamp(ros_ns)},
        "voltage": nan if volts is None else volts,
        "present": volts is not None,
        "power_supply_status": CHARGE["unknown" if volts is None else plugged],
    }


def odometry_constant(frame: str, child: str) -> Fields:
    """The fields that are the same in all Odometry messages."""
    return {"header": {"frame_id": frame}, "child_frame_id": child}


def odometry_covariances(sample: Odometry) -> Fields:
    """The constant covariances of Odometry messages: the twist's from the service's settings, and zeros for the pose's,
    which a stencil fills in."""
    twist = [0.0] * 36
    twist[X] = twist[Y] = sample.twist_std_mps**2
    twist[YAW] = sample.twist_std_radps**2
    return {"pose": {"covariance": [0.0] * 36}, "twist": {"covariance": twist}}


ODOMETRY_PLACES = ("header.stamp", "pose.pose", "pose.covariance", "twist.twist")


def _covariance(sample: Odometry) -> Sequence[float]:
    """The pose's covariance as 36 numbers: rows of x, y, z, and of the turns about them."""
    xx, xy, xt, yy, yt, tt = sample.pose_covariance
    zeros = (0.0,) * 12
    return (xx, xy, 0.0, 0.0, 0.0, xt, xy, yy, 0.0, 0.0, 0.0, yt, *zeros, *zeros[:6], xt, yt, 0.0, 0.0, 0.0, tt)


def _pose(sample: Odometry) -> Sequence[float]:
    """The pose as seven numbers: x, y, z and a quaternion."""
    return (sample.x_m, sample.y_m, 0.0, 0.0, 0.0, sin(sample.th_rad / 2), cos(sample.th_rad / 2))


def odometry(sample: Odometry, ros_ns: int) -> Values:
    """The changing values of a nav_msgs/Odometry."""
    twist = (sample.vx_mps, sample.vy_mps, 0.0, 0.0, 0.0, sample.wz_radps)
    return _stamped(ros_ns), _pose(sample), _covariance(sample), twist


TRANSFORM_PLACES = ("transforms.0.header.stamp", "transforms.0.transform")


def transform_constant(frame: str, child: str) -> Fields:
    """The fields that are the same in all TransformStamped messages."""
    return {"header": {"frame_id": frame}, "child_frame_id": child}


def transform(sample: Odometry, ros_ns: int) -> Values:
    """The changing values of a tf2_msgs/TFMessage with the pose."""
    return _stamped(ros_ns), _pose(sample)


GAMEPAD_PLACES = ("header.stamp", "axes", "buttons")
GAMEPAD_CONSTANT: Fields = {"axes": [0.0] * 5, "buttons": [0] * BUTTONS}
"""Arrays of the right lengths, which never change."""


def gamepad(sample: Pad, ros_ns: int) -> Values:
    """The changing values of a sensor_msgs/Joy."""
    axes = (*(axis / FULL_AXIS for axis in sample.axes), float(sample.hat))
    return _stamped(ros_ns), axes, [sample.buttons >> bit & 1 for bit in range(BUTTONS)]


OLD_S = 0.5
"""If a report of the wheels is older than this, s, it does not show how fast they turn now."""
JOINT_PLACES = ("header.stamp", "position", "velocity")


class Wheels:
    """The wheels as joints: how far each has turned, and how fast it turns (positive: forward). These come from the
    board's reports if it sends any, otherwise from the commands."""

    def __init__(self) -> None:
        self._names: list[str] = []
        """The names of the joints. Empty until a service has reported its wheels."""
        self._steering_rad: dict[str, float] = {}
        """The steering's joint and its angle. Empty if the base is not steered, or if no angle was commanded yet."""
        self._position_rad: list[float] = []
        self._velocity_radps: list[float] = []
        self._begun_rad: list[float] = []
        """The positions when the present run of the service began. The service counts from zero in each run."""
        self._run = ""
        self._measured = False
        self._ns = 0

    def update(
        self,
        wheels_radps: snapshot.Wheels | None,
        now_ns: int,
        steering_rad: float | None = None,
        turning: snapshot.Turning | None = None,
        run: str = "",
    ) -> None:
        """Note the present speeds. `wheels_radps`: State.wheels_radps, or None without a service. Without a service, a
        commanded speed is zero, and a measured speed is NaN. `steering_rad`: State.steering_rad; None keeps the angle.
        `turning`: State.turning. If the board reports its wheels, only the reports are used, and the speed is NaN after
        an old report. `run`: identifies the run of the service. In a later run the positions go on, and don't jump."""
        if steering_rad is not None:
            self._steering_rad = {"steering": steering_rad}
        if not self._measured:
            for at, speed_radps in enumerate(self._velocity_radps):
                self._position_rad[at] += speed_radps * (now_ns - self._ns) / 1e9
        self._ns = now_ns
        if wheels_radps is None:
            self._velocity_radps = [nan if self._measured else 0.0] * len(self._names)
            return
        if len(wheels_radps) != len(self._names):
            self._names = [f"wheel_{name}" for name in wheels_radps.names]
            self._position_rad = [0.0] * len(self._names)
        if run != self._run or len(self._begun_rad) != len(self._names):
            self._run, self._begun_rad = run, list(self._position_rad)
        seen = turning.speeds_radps if turning else None
        self._measured = seen is not None and len(seen) == len(self._names)
        if not turning or not seen or not self._measured:
            self._velocity_radps = list(wheels_radps)
            return
        old = turning.age_s is None or turning.age_s > OLD_S
        self._velocity_radps = [nan] * len(seen) if old else list(seen)
        if turning.turned_rad and len(turning.turned_rad) == len(self._names):
            turned = zip(self._begun_rad, turning.turned_rad, strict=True)
            self._position_rad = [begun + since for begun, since in turned]

    def fields(self, ros_ns: int, arm: ArmState | None = None) -> tuple[list[str], Values]:
        """The names of the joints, and the changing values of a sensor_msgs/JointState. `arm`: State.arm. A joint of
        the arm that was not read yet is left out. While such a joint moves, its position is the commanded one."""
        joints = arm.joints if arm else {}
        at = {name: joint.at_rad for name, joint in joints.items() if joint.at_rad is not None}
        found = {**self._steering_rad, **at}
        position = [*self._position_rad, *found.values()]
        return [*self._names, *found], (_stamped(ros_ns), position, [*self._velocity_radps, *([0.0] * len(found))])
