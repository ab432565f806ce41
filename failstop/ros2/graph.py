"""Graph: reads from DDS who publishes cmd_vel, for both threads of the bridge, and requests a stop for a wrong
publisher."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from failstop.api.errors import FailstopError
from failstop.ros2.commanders import Commanders, Publisher
from failstop.ros2.link import RobotLink
from failstop.ros2.shared import Shared

BEST_EFFORT = 2
TRANSIENT_LOCAL = 1


class Graph:
    """Who publishes cmd_vel, as this node sees it. `commanders` may be read and changed only under the lock."""

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
        """Read who publishes cmd_vel. Requests a stop if several nodes publish, or a node that is not allowed. This
        takes about 20 us while nothing changes."""
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
    """A function that counts a topic's publishers: rclpy's internal one if that works. The node's own method is slower,
    because it expands and checks the topic's name at every call."""
    try:
        count: Callable[[str], int] = node.handle.get_count_publishers
        if isinstance(count(topic), int):
            return count
    except (AttributeError, TypeError):
        pass
    own: Callable[[str], int] = node.count_publishers
    return own


def publishers(node: Any, topic: str) -> list[Publisher]:
    """The publishers of a topic, as this node sees them."""
    return [_publisher(found) for found in node.get_publishers_info_by_topic(topic)]


def latch(node: Any, link: RobotLink, cause: str) -> bool:
    """Request a latched stop through the stop pipe. Logs the cause, and an error if there is nothing to stop. Returns
    True if the stop was requested."""
    try:
        link.stop(cause)
    except FailstopError as error:
        node.get_logger().error(f"{cause}, and there is nothing to stop: {error}")
        return False
    node.get_logger().error(f"E-STOP: {cause}")
    return True


def _publisher(found: Any) -> Publisher:
    """A Publisher from DDS's information about it."""
    name = found.node_name
    node = "" if not name or name.startswith("_NODE_NAME_UNKNOWN_") else f"{found.node_namespace.rstrip('/')}/{name}"
    # A publisher with unknown reliability counts as reliable.
    qos = found.qos_profile
    lasting = int(qos.durability) == TRANSIENT_LOCAL
    return Publisher(node, found.topic_type, int(qos.reliability) != BEST_EFFORT, lasting)
