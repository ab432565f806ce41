"""A ROS 2 driver of the usual kind, for the probe: `python base.py TIMEOUT_S`. It obeys /cmd_vel and tells /odom; with
a timeout of 0 it keeps the last velocity. Each change of what its wheels do is a line: when (ns), and whether they
turn. Never imported by a test."""

from __future__ import annotations

import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

PERIOD_S = 0.02


def main(timeout_s: float) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("base")
    speed = x = heard_s = 0.0

    def obey(message: Twist) -> None:
        nonlocal speed, heard_s
        # As many do: what is no number is taken for one.
        speed, heard_s = message.linear.x, time.monotonic()

    node.create_subscription(Twist, "/cmd_vel", obey, QoSProfile(depth=1))
    publisher = node.create_publisher(Odometry, "/odom", QoSProfile(depth=10))
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
            message = Odometry()
            message.twist.twist.linear.x, message.pose.pose.position.x = speed, x
            publisher.publish(message)


main(float(sys.argv[1]))
