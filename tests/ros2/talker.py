"""A ROS node that does what the test tells it, line by line: `python talker.py NAME`. Never imported by a test."""

from __future__ import annotations

import importlib
import json
import math
import queue
import re
import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LONGEST_S = 0.1
"""Of a turn in which nothing is heard."""


def type_of(name: str) -> Any:
    package, kind, last = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), last)


def build(message: object, fields: dict) -> object:
    for name, value in fields.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            kind = message.get_fields_and_field_types()[name]  # type: ignore[attr-defined]
            package, *_, last = re.findall(r"\w+", kind.removeprefix("sequence"))
            setattr(message, name, [build(type_of(f"{package}/msg/{last}")(), row) for row in value])
        elif isinstance(value, dict):
            build(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    return [plain(item) for item in (value.tolist() if hasattr(value, "tolist") else value)]


def profile(words: dict) -> QoSProfile:
    return QoSProfile(
        depth=words.get("depth", 10),
        reliability=ReliabilityPolicy.RELIABLE if words.get("reliable", True) else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if words.get("lasting") else DurabilityPolicy.VOLATILE,
    )


class Talker:
    def __init__(self, name: str) -> None:
        self.asked: queue.Queue = queue.Queue()
        self.become(name)
        threading.Thread(target=self._read, daemon=True).start()

    def become(self, name: str) -> dict:
        rclpy.init(args=["talker", *sys.argv[2:]])
        self.node = rclpy.create_node(name)
        self.publishers: dict = {}
        self.kinds: dict = {}
        self.repeats: dict = {}
        self.count: dict = {}
        self.heard: dict = {}
        self.subscriptions: dict = {}
        self.clients: dict = {}
        self.actions: dict = {}
        self.feedback: list = []
        self.goal: Any = None
        self.executor: Any = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        return {}

    def retire(self) -> dict:
        """Leave the graph in order, and wait to become another: that costs a fraction of a process."""
        executor, self.executor = self.executor, None
        executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()
        return {}

    def _read(self) -> None:
        for line in sys.stdin:
            self._put(json.loads(line))
        self._put({"do": "quit"})

    def _put(self, asked: dict) -> None:
        self.asked.put(asked)
        if executor := self.executor:
            executor.create_task(lambda: None)  # it wakes up

    def run(self) -> None:
        answer({"ready": True})
        while True:
            if self.executor:
                self._turn(LONGEST_S)
            while not self.executor or not self.asked.empty():
                asked = self.asked.get()
                if asked["do"] == "quit":
                    if self.executor:
                        self.retire()
                    return
                answer(getattr(self, asked.pop("do"))(**asked))

    def _turn(self, longest_s: float) -> None:
        due_s = min((repeat["due_s"] for repeat in self.repeats.values()), default=math.inf)
        self.executor.spin_once(timeout_sec=min(max(due_s - time.monotonic(), 0.0), longest_s))
        self._repeat()

    def _repeat(self) -> None:
        now_s = time.monotonic()
        for repeat in self.repeats.values():
            if repeat["due_s"] <= now_s:
                repeat["due_s"] = max(repeat["due_s"] + repeat["every_s"], now_s)
                self.publish(repeat["topic"], repeat["fields"], repeat["stamp"])

    def advertise(self, topic: str, type: str, qos: dict | None = None) -> dict:
        self.kinds[topic] = type_of(type)
        self.publishers[topic] = self.node.create_publisher(type_of(type), topic, profile(qos or {}))
        return {}

    def matched(self, topic: str) -> dict:
        return {"count": self.publishers[topic].get_subscription_count()}

    def publish(self, topic: str, fields: dict, stamp: bool = False) -> dict:
        publisher = self.publishers[topic]
        message = build(self.kinds[topic](), fields)
        if stamp:
            now_ns = self.node.get_clock().now().nanoseconds
            message.header.stamp.sec, message.header.stamp.nanosec = now_ns // 10**9, now_ns % 10**9  # type: ignore[attr-defined]
        publisher.publish(message)
        self.count[topic] = self.count.get(topic, 0) + 1
        return {"t_ns": time.monotonic_ns()}

    def repeat(self, topic: str, fields: dict, hz: float, stamp: bool = False) -> dict:
        due_s = time.monotonic()
        self.repeats[topic] = {"topic": topic, "fields": fields, "every_s": 1 / hz, "due_s": due_s, "stamp": stamp}
        return {}

    def sent(self, topic: str) -> dict:
        return {"count": self.count.get(topic, 0)}

    def rest(self, topic: str) -> dict:
        self.repeats.pop(topic, None)
        return {"t_ns": time.monotonic_ns()}

    def hear(self, topic: str, type: str, qos: dict | None = None) -> dict:
        heard = self.heard[topic] = []

        def take(message: object) -> None:
            heard.append([time.monotonic_ns(), time.time(), plain(message)])

        self.subscriptions[topic] = self.node.create_subscription(type_of(type), topic, take, profile(qos or {}))
        return {}

    def deaf(self, topic: str) -> dict:
        self.node.destroy_subscription(self.subscriptions.pop(topic))
        return {}

    def take(self, topic: str, wait_s: float = 0.0) -> dict:
        """Messages heard since the last time; `wait_s`: wait so long for the first of it."""
        until_s = time.monotonic() + wait_s
        while not self.heard[topic] and (left_s := until_s - time.monotonic()) > 0:
            self._turn(min(left_s, LONGEST_S))
        found, self.heard[topic][:] = list(self.heard[topic]), []
        return {"heard": found}

    def call(self, service: str, type: str, fields: dict, timeout_s: float = 5.0) -> dict:
        kind = type_of(type)
        client = self.clients.setdefault(service, self.node.create_client(kind, service))
        if not client.wait_for_service(timeout_sec=timeout_s):
            return {"error": "no service"}
        future = client.call_async(build(kind.Request(), fields))
        begun_s = time.monotonic()
        while not future.done() and time.monotonic() - begun_s < timeout_s:
            self.executor.spin_once(timeout_sec=0.01)
        if not future.done():
            return {"error": "no answer"}
        return {"took_s": time.monotonic() - begun_s, **plain(future.result())}

    def _spin(self, future: Any, timeout_s: float) -> Any:
        until_s = time.monotonic() + timeout_s
        while not future.done() and time.monotonic() < until_s:
            self.executor.spin_once(timeout_sec=0.01)
        return future.result()

    def send_goal(self, action: str, type: str, fields: dict) -> dict:
        from rclpy.action import ActionClient

        kind = type_of(type)
        client = self.actions.setdefault(action, ActionClient(self.node, kind, action))
        if not client.wait_for_server(timeout_sec=10.0):
            return {"error": "no server"}
        heard: list = []
        goal = build(kind.Goal(), fields)
        sent = client.send_goal_async(goal, feedback_callback=lambda message: heard.append(plain(message.feedback)))
        found = self._spin(sent, 10.0)
        if found.accepted:
            self.goal, self.feedback = found, heard
        return {"accepted": found.accepted}

    def fed_back(self) -> dict:
        self.executor.spin_once(timeout_sec=0.01)
        return {"feedback": self.feedback}

    def cancel(self) -> dict:
        return {"cancelling": len(self._spin(self.goal.cancel_goal_async(), 10.0).goals_canceling)}

    def outcome(self) -> dict:
        found = self._spin(self.goal.get_result_async(), 15.0)
        return {"status": found.status, **plain(found.result)}

    def get_parameters(self, node: str, names: list[str]) -> dict:
        return self.call(f"{node}/get_parameters", "rcl_interfaces/srv/GetParameters", {"names": names})

    def set_parameter(self, node: str, name: str, value: float | str) -> dict:
        message = type_of("rcl_interfaces/msg/Parameter")()
        message.name, message.value.type = name, 4 if isinstance(value, str) else 3
        setattr(message.value, "string_value" if isinstance(value, str) else "double_value", value)
        return self.call(f"{node}/set_parameters", "rcl_interfaces/srv/SetParameters", {"parameters": [message]})

    def graph(self) -> dict:
        topics = self.node.get_topic_names_and_types()
        services = self.node.get_service_names_and_types()
        return {"topics": dict(topics), "services": dict(services)}

    def ends(self, topic: str, of: str) -> dict:
        infos = getattr(self.node, f"get_{of}_info_by_topic")(topic)
        return {
            "ends": [
                {
                    "node": f"{info.node_namespace.rstrip('/')}/{info.node_name}",
                    "type": info.topic_type,
                    "reliable": info.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
                    "lasting": info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
                }
                for info in infos
            ]
        }


def answer(found: dict) -> None:
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()


Talker(sys.argv[1]).run()
