"""Facts of a ROS, as JSON: a fact's name says what it is; none depends on chance. Never imported by a test. In the
environment of a real one: `python tests/ros2/facts_seen.py > tests/ros2/facts.json` renews what is recorded."""

from __future__ import annotations

import json
import math
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Since Iron, messages check the types of their fields only where this asks for it, and read it as they are imported.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from failstop.ros2.fill import type_of

STAND_IN = Path(__file__).parent / "standin/rclpy/types.py"
DEADLINE_S = 20.0
QUIET_S = 1.0
"""The longest wait for a message: one that has not come by then does not come."""


TWIST, BOOL = type_of("geometry_msgs/msg/Twist"), type_of("std_msgs/msg/Bool")


def plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (str, bool, int, float)):
        return value
    return [plain(item) for item in (value.tolist() if hasattr(value, "tolist") else value)]


def profile(reliable: bool, lasting: bool = False) -> QoSProfile:
    return QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if lasting else DurabilityPolicy.VOLATILE,
    )


class Pair:
    """Two nodes, and an executor for both."""

    def __init__(self) -> None:
        self.one, self.other = rclpy.create_node("one"), rclpy.create_node("other")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.one)
        self.executor.add_node(self.other)

    def within(self, check: Callable[[], object], seconds: float = DEADLINE_S) -> bool:
        until_s = time.monotonic() + seconds
        while not check():
            if time.monotonic() > until_s:
                return False
            self.executor.spin_once(timeout_sec=0.01)
        return True


def raises(act: Callable[[], object]) -> str:
    try:
        act()
    except Exception as error:
        return type(error).__name__
    return ""


def messages() -> dict[str, Any]:
    """The defaults of every message that the stand-in has, but for failstop's own, which few have built."""
    names = re.findall(r"^(?!failstop)(\w+/msg/\w+):", STAND_IN.read_text(), re.MULTILINE)
    return {name: plain(type_of(name)()) for name in names}


def fields() -> dict[str, str]:
    twist, point = TWIST(), type_of("trajectory_msgs/msg/JointTrajectoryPoint")()
    return {
        "an int in a float64": raises(lambda: setattr(twist.linear, "x", 1)),
        "a NaN in a float64": raises(lambda: setattr(twist.linear, "x", math.nan)),
        "a text in a bool": raises(lambda: setattr(BOOL(), "data", "yes")),
        "ints in a sequence of float64": raises(lambda: setattr(point, "positions", [1, 2])),
        "a field that is not there": raises(lambda: setattr(twist, "linnear", 1)),
    }


def matching(pair: Pair) -> dict[str, Any]:
    """True where a publisher and a subscription of these qualities find each other."""
    sorts = {"reliable": True, "best effort": False}
    return {f"{one} to {other}": matches(pair, sorts[one], sorts[other]) for one in sorts for other in sorts}


def matches(pair: Pair, publisher: bool, subscription: bool) -> bool:
    topic = f"matching_{publisher}_{subscription}"
    sender = pair.one.create_publisher(BOOL, topic, profile(publisher))
    pair.other.create_subscription(BOOL, topic, lambda message: None, profile(subscription))
    pair.within(lambda: pair.one.count_subscribers(topic) == 1)
    return pair.within(sender.get_subscription_count, QUIET_S)


def late(pair: Pair) -> dict[str, int]:
    """The number of earlier messages that a subscription hears which comes late."""
    return {"volatile": caught_up(pair, False), "transient local": caught_up(pair, True)}


def caught_up(pair: Pair, lasting: bool) -> int:
    sender = pair.one.create_publisher(BOOL, f"late_{lasting}", profile(True, lasting))
    sender.publish(BOOL(data=True))
    heard: list[Any] = []
    pair.other.create_subscription(BOOL, f"late_{lasting}", heard.append, profile(True, lasting))
    pair.within(lambda: heard, DEADLINE_S if lasting else QUIET_S)
    return len(heard)


def graph(pair: Pair) -> dict[str, Any]:
    """The ends that a topic's count has, by one node's view of it."""
    seen: dict[str, Any] = {"nobody": pair.other.count_publishers("/counted")}
    ends = [pair.one.create_publisher(TWIST, "counted", profile(reliable)) for reliable in (True, False)]
    seen["of another quality too"] = pair.within(lambda: pair.other.count_publishers("/counted") == 2)

    def named() -> bool:
        infos = pair.other.get_publishers_info_by_topic("/counted")
        return len(infos) == 2 and all(info.node_name == "one" for info in infos)

    seen["their names"] = pair.within(named)
    infos = pair.other.get_publishers_info_by_topic("/counted")
    seen["namespaces"] = [info.node_namespace for info in infos]
    seen["types"] = sorted(info.topic_type for info in infos)
    seen["reliability by number"] = sorted(int(info.qos_profile.reliability) for info in infos)
    pair.one.destroy_publisher(ends[0])
    seen["one left"] = pair.within(lambda: pair.other.count_publishers("/counted") == 1)
    return seen


def parameters(pair: Pair) -> dict[str, Any]:
    node = pair.one
    return {
        "given a value of another type": raises(lambda: node.declare_parameter("given", 1.0)),
        "declared twice": bool(raises(lambda: (node.declare_parameter("once", 1), node.declare_parameter("once", 2)))),
    }


def clock(pair: Pair) -> dict[str, Any]:
    return {"with use_sim_time and no /clock": pair.one.get_clock().now().nanoseconds}


def main() -> None:
    words = ["--ros-args", "-p", "given:=text", "-p", "use_sim_time:=true"]
    rclpy.init(args=["facts", *words])
    pair = Pair()
    found = {"messages": messages(), "fields": fields(), "parameters": parameters(pair), "clock": clock(pair)}
    found |= {"matching": matching(pair), "late": late(pair), "graph": graph(pair)}
    sys.stdout.write(json.dumps(found, indent=1, sort_keys=True) + "\n")
    sys.stdout.flush()
    rclpy.try_shutdown()


main()
