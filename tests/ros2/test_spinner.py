"""The spinner: what it takes by itself, and what it leaves to rclpy's executor."""

from __future__ import annotations

import json
import sys

from tests.ros2.scene import Ros

PROGRAM = """
import json
import time

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from failstop.ros2.spinner import Spinner

rclpy.init()
node = rclpy.create_node("spun")
heard = []


def answer(_request, response):
    response.success, response.message = True, "answered"
    return response


def spin_until(wanted):
    until_s = time.monotonic() + 20
    while not wanted() and time.monotonic() < until_s:
        spinner.turn(0.05)


node.create_subscription(String, "words", lambda message: heard.append(message.data), QoSProfile(depth=10))
words = node.create_publisher(String, "words", 10)
received = []
spinner = Spinner(node, lambda *about: received.append(about))
spin_until(lambda: words.get_subscription_count())
for text in ("one", "two", "three"):
    words.publish(String(data=text))
sent_ns = time.time_ns()
spin_until(lambda: len(heard) == 3)
waited_s = [abs(sent_ns - at_ns) / 1e9 for about in received if any(about) for at_ns in about]

# What is made later is heard too.
late = node.create_subscription(Bool, "late", lambda message: heard.append(message.data), QoSProfile(depth=10))
publisher = node.create_publisher(Bool, "late", 10)
spin_until(lambda: publisher.get_subscription_count())
publisher.publish(Bool(data=True))
spin_until(lambda: len(heard) == 4)
node.destroy_subscription(late)
spinner.turn(0.0)

client = node.create_client(Trigger, "ask")
node.create_service(Trigger, "ask", answer)
client.wait_for_service(timeout_sec=20.0)
asked = client.call_async(Trigger.Request())
spin_until(asked.done)

turns, until_s = 0, time.monotonic() + 0.5
while time.monotonic() < until_s:
    spinner.turn(0.05)
    turns += 1
print(json.dumps([heard, asked.done() and asked.result().message, spinner._plain, turns, waited_s]))
"""


def test_it_hears_answers_and_waits(ros: Ros) -> None:
    done = ros.run(sys.executable, "-c", PROGRAM)
    assert not done.returncode, done.stderr
    heard, answered, plain, turns, waited_s = json.loads(done.stdout)
    assert heard == ["one", "two", "three", True]
    assert answered == "answered"
    # Only ROS itself has a wait set to keep.
    assert plain != ros.real
    assert turns < 30  # it waits when there is nothing
    assert len(waited_s) == (0 if plain else 6), "when each was sent and received"
    assert all(wait_s < 20 for wait_s in waited_s)
