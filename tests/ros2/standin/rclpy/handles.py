"""The stand-in's handles and waitables, as far as rclpy's internals show them."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace


class Handle:
    """What rclpy's internals know an entity by."""

    def __init__(self, waiting: deque) -> None:
        self.waiting = waiting

    @property
    def pointer(self) -> int:
        return id(self)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


class SubscriptionHandle(Handle):
    def __init__(self, subscription: object) -> None:
        super().__init__(subscription.waiting)
        self._subscription = subscription

    def take_message(self, msg_type: type, raw: bool) -> tuple[object, dict[str, int]] | None:
        """A message with the times when it was received and sent."""
        assert (msg_type, raw) == (self._subscription.msg_type, self._subscription.raw)
        if not self.waiting:
            return None
        sent_ns, received_ns = self.waiting[0][1], self.waiting[0][3]
        message = self._subscription.take()
        return message, {"source_timestamp": sent_ns, "received_timestamp": received_ns}


class NodeHandle:
    def __init__(self, node: object) -> None:
        self._node = node

    def get_count_publishers(self, topic: str) -> int:
        assert topic.startswith("/"), "rcl takes full names alone"
        return self._node.count_publishers(topic)


class Events:
    """What DDS reports of the node's own ends: a waitable that counts nothing but events."""

    def get_num_entities(self) -> object:
        names = ("subscriptions", "guard_conditions", "timers", "clients", "services")
        return SimpleNamespace(**{f"num_{name}": 0 for name in names}, num_events=1)

    def add_to_wait_set(self, wait_set: object) -> None:
        raise AssertionError("a waitable of events alone is left out")

    def is_ready(self, wait_set: object) -> bool:
        return False
