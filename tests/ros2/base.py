"""A ROS 2 driver of the usual kind, for the probe: `python base.py TIMEOUT_S`. It obeys /cmd_vel, and tells /odom and
/imu; with a timeout of 0 it keeps the last velocity. Each change of what its wheels do is a line: when (ns), and
whether they turn. Never imported by a test."""

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


def main(timeout_s: float) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("base")
    speed = x = heard_s = 0.0

    def obey(message: Any) -> None:
        nonlocal speed, heard_s
        # As many do: what is no number is taken for one.
        speed, heard_s = message.linear.x, time.monotonic()

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
            speed = 0.0
        if bool(speed) is not turned:
            turned = bool(speed)
            print(time.monotonic_ns(), int(turned), flush=True)
        if now_s >= due_s:
            due_s = now_s + PERIOD_S
            x += speed * PERIOD_S
            message = odometry()
            message.twist.twist.linear.x, message.pose.pose.position.x = speed, x
            publisher.publish(message)
            felt = imu()
            felt.angular_velocity.x = random.gauss(0.0, 0.2 if speed else 0.01)
            felt.angular_velocity.y = random.gauss(0.0, 0.2 if speed else 0.01)
            shakes.publish(felt)


main(float(sys.argv[1]))
