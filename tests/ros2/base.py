"""A ROS 2 driver of the usual kind, for the probe: `python base.py TIMEOUT_S [brief|jitters|numb]`. It obeys
/cmd_vel, and tells /odom and /imu; with a timeout of 0 it keeps the last velocity. A brief one stops its wheels BRIEF_S
after they began to turn, and turns them again after a zero. The odometry of one that jitters is never at rest, as one
that has an IMU in it; the IMU of a numb one feels nothing. Each change of what its wheels do is a line: when (ns),
and whether they turn. Never imported by a test."""

from __future__ import annotations

import random
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from failstop.ros2.fill import type_of

PERIOD_S = 0.02
BRIEF_S = 0.75


def main(timeout_s: float, *more: str) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("base")
    told = speed = x = heard_s = began_s = 0.0

    def obey(message: Any) -> None:
        nonlocal told, heard_s, began_s
        # As many do: what is no number is taken for one.
        before, told, heard_s = told, message.linear.x, time.monotonic()
        began_s = began_s if before else heard_s

    odometry = type_of("nav_msgs/msg/Odometry")
    node.create_subscription(type_of("geometry_msgs/msg/Twist"), "/cmd_vel", obey, QoSProfile(depth=1))
    publisher = node.create_publisher(odometry, "/odom", QoSProfile(depth=10))
    imu = type_of("sensor_msgs/msg/Imu")
    shakes = node.create_publisher(imu, "/imu", QoSProfile(depth=10))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    turned, due_s = False, time.monotonic()
    while True:
        executor.spin_once(timeout_sec=max(0.0, due_s - time.monotonic()))
        now_s = time.monotonic()
        if timeout_s and now_s - heard_s > timeout_s:
            told = 0.0
        speed = 0.0 if "brief" in more and now_s - began_s > BRIEF_S else told
        if bool(speed) is not turned:
            turned = bool(speed)
            print(time.monotonic_ns(), int(turned), flush=True)
        if now_s >= due_s:
            due_s = now_s + PERIOD_S
            x += speed * PERIOD_S
            message = odometry()
            message.twist.twist.linear.x, message.pose.pose.position.x = speed, x
            message.pose.pose.orientation.z = random.gauss(0.0, 1e-4) if "jitters" in more else 0.0
            publisher.publish(message)
            felt = imu()
            shaking = 0.0 if "numb" in more else 0.2 if speed else 0.01
            felt.angular_velocity.x, felt.angular_velocity.y = random.gauss(0.0, shaking), random.gauss(0.0, shaking)
            shakes.publish(felt)


main(float(sys.argv[1]), *sys.argv[2:])
