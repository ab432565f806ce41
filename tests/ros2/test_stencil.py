"""A stencil's bytes are those that ROS makes of the same message; without a serialiser the message itself is filled."""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass, field

import pytest

from failstop.ros2.stencil import Stencil
from tests.ros2.scene import Ros

TYPES = {"sec": "int32", "nanosec": "uint32", "x": "double", "y": "double", "axes": "sequence<float>"}
STAMP = "stamp"


class Message:
    def get_fields_and_field_types(self) -> dict[str, str]:
        return {name: TYPES.get(name, "somebody/Else") for name in vars(self)}


@dataclass
class Stamp(Message):
    sec: int = 0
    nanosec: int = 0


@dataclass
class Point(Message):
    x: float = 0.0
    y: float = 0.0


@dataclass
class Moved(Message):
    stamp: Stamp = field(default_factory=Stamp)
    point: Point = field(default_factory=Point)
    axes: list[float] = field(default_factory=lambda: [0.0, 0.0])
    points: list[Point] = field(default_factory=lambda: [Point()])


PLACES = (STAMP, "point", "axes", "points.0.x")
VALUES = ((1, 2), (3.0, 4.0), (5.0, 6.0), (7.0,))


def serialize(message: Moved) -> bytes:
    stamp, point = message.stamp, message.point
    head = struct.pack("<iI2d2f", stamp.sec, stamp.nanosec, point.x, point.y, *message.axes)
    return b"head" + head + struct.pack("<2d", message.points[0].x, message.points[0].y)


def filled() -> Moved:
    return Moved(Stamp(1, 2), Point(3.0, 4.0), [5.0, 6.0], [Point(7.0, 0.0)])


def test_bytes_are_those_of_the_message() -> None:
    stencil = Stencil(Moved(), PLACES, serialize)
    assert stencil.filled(VALUES) == serialize(filled())
    assert stencil.filled(((9, 9), *VALUES[1:])) == serialize(filled()).replace(
        struct.pack("<iI", 1, 2), struct.pack("<iI", 9, 9)
    )


def test_without_a_serialiser_the_message_is_filled() -> None:
    assert Stencil(Moved(), PLACES, None).filled(VALUES) == filled()


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(lambda message: serialize(message).replace(b"\x01", b"\x01\x01"), id="numbers that are not whole"),
        pytest.param(lambda message: serialize(message) * 2, id="numbers that are there twice"),
        pytest.param(lambda message: serialize(message)[::-1], id="the bytes of another order"),
    ],
)
def test_where_the_numbers_are_not_found_once_the_message_is_filled(other: object) -> None:
    assert Stencil(Moved(), PLACES, other).filled(VALUES) == filled()  # type: ignore[arg-type]


def test_what_ros_reads_in_the_bytes(ros: Ros) -> None:
    """The bridge's own stencils, against rclpy. Bytes that only align others are anything."""
    if not ros.real:
        pytest.skip("only ROS itself serialises")
    done = ros.run(sys.executable, "-c", PROGRAM)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["bytes", "True"] * 5


PROGRAM = """
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState, Joy
from tf2_msgs.msg import TFMessage

from failstop.api import snapshot
from failstop.ros2 import messages
from failstop.ros2.fill import fill
from failstop.ros2.stencil import Stencil, serializer

S = 10**9
moved = snapshot.Odometry(0, 1.25, -2.5, 0.7, 0.2, 0.1, 0.3, 0.05, 0.2)
wheels = messages.Wheels()
wheels.update(snapshot.Wheels((1.0, 2.0, 3.0, 4.0)), 0)
wheels.update(snapshot.Wheels((1.5, 2.0, 3.0, 4.0)), S)
names, joints = wheels.fields(5 * S + 3)


def transform():
    return {"transforms": [fill(TransformStamped(), messages.transform_constant("odom_of_a_robot", "base"))]}


rows = (
    (Imu, lambda: messages.imu_constant("imu_link", 1e-6), messages.IMU_PLACES,
     messages.imu(snapshot.Imu(5, (1.0, 2.0, 9.8), (0.1, 0.2, 0.3)), 3 * S + 7)),
    (Odometry, lambda: {**messages.odometry_constant("odom", "base_link"), **messages.odometry_covariances(moved)},
     messages.ODOMETRY_PLACES, messages.odometry(moved, 1_700_000_000 * S + 999_999_999)),
    (TFMessage, transform, messages.TRANSFORM_PLACES, messages.transform(moved, S)),
    (Joy, lambda: messages.GAMEPAD_CONSTANT, messages.GAMEPAD_PLACES,
     messages.gamepad(snapshot.Pad(0, 0x8001, 3, (127, -128, 0, 64), "drive"), S)),
    (JointState, lambda: {"name": names, "position": [0.0] * 4, "velocity": [0.0] * 4}, messages.JOINT_PLACES, joints),
)
for kind, constant, places, values in rows:
    found = Stencil(fill(kind(), constant()), places, serializer()).filled(values)
    wanted = Stencil(fill(kind(), constant()), places, None).filled(values)
    print(type(found).__name__, deserialize_message(found, kind) == wanted)
"""
