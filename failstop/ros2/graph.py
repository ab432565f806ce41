"""Graph: what DDS says of the publishers of cmd_vel, asked by both of the bridge's threads; a stop where it must be."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from failstop.api.errors import FailstopError
from failstop.ros2.commanders import Commanders, Publisher
from failstop.ros2.link import RobotLink
from failstop.ros2.shared import Shared

BEST_EFFORT = 2


class Graph:
    """The node's view, and who commands by it. `commanders` is read and changed under its lock."""

    def __init__(self, node: Any, topic: str, commanders: Commanders, shared: Shared) -> None:
        self._node = node
        self._topic = topic
        self._count = _counter(node, topic)
        self._shared = shared
        self._lock = threading.Lock()
        self.commanders = commanders

    def publishers(self, topic: str) -> list[Publisher]:
        """The publishers of a topic."""
        return publishers(self._node, topic)

    def ask(self, link: RobotLink, now_ns: int) -> None:
        """The publishers of cmd_vel; a second one, or a stranger, is a stop. Takes some 20 us while nothing changes."""
        with self._lock:
            commanders = self.commanders
            count = self._count(self._topic)
            if commanders.wants_look(count, now_ns):
                commanders.look(self.publishers(self._topic), now_ns)
            commanders.counted(count, now_ns)
            cause = commanders.cause(now_ns)
            state = self._shared.state
            due = commanders.due(cause, state is not None and state.estop is not None, now_ns)
        if due:
            latch(self._node, link, cause)


def _counter(node: Any, topic: str) -> Callable[[str], int]:
    """The call that counts the publishers of a topic: rclpy's internal one if it answers, because the node's own
    expands and checks the name each time."""
    try:
        count: Callable[[str], int] = node.handle.get_count_publishers
        if isinstance(count(topic), int):
            return count
    except (AttributeError, TypeError):
        pass
    own: Callable[[str], int] = node.count_publishers
    return own


def publishers(node: Any, topic: str) -> list[Publisher]:
    """The publishers of a topic, as a node sees them."""
    return [_publisher(found) for found in node.get_publishers_info_by_topic(topic)]


def latch(node: Any, link: RobotLink, cause: str) -> None:
    """A latched stop, by the stop pipe."""
    try:
        link.stop(cause)
        node.get_logger().error(f"E-STOP: {cause}")
    except FailstopError as error:
        node.get_logger().error(f"{cause}, and there is nothing to stop: {error}")


def _publisher(found: Any) -> Publisher:
    """An endpoint of the graph."""
    name = found.node_name
    node = "" if not name or name.startswith("_NODE_NAME_UNKNOWN_") else f"{found.node_namespace.rstrip('/')}/{name}"
    # One of unknown quality is given the benefit of the doubt.
    return Publisher(node, found.topic_type, int(found.qos_profile.reliability) != BEST_EFFORT)
