"""Spinner: waits for what arrives, and calls the node's callbacks, in one thread.

An executor of rclpy makes a wait set, a task and a coroutine for each message, and asks every entity of the node twice:
0.7 ms a message. This one keeps its wait set and takes messages itself; the rest (services, actions, whatever awaits)
it leaves to rclpy's executor when there is some. Where rclpy has no such wait set, that executor does everything.
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Any

AWAITED_S = 0.002
"""How soon what awaits is looked at again."""
EVENTS_S = 1.0
"""How often what DDS tells of the node's own ends is looked at: rclpy writes lines of it."""
MOST_AT_ONCE = 10
COUNTS = ("num_subscriptions", "num_guard_conditions", "num_timers", "num_clients", "num_services")
"""The parts of a wait set, in its order; events come last."""


class Spinner:
    """One node's, of one thread."""

    def __init__(self, node: Any, received: Callable[[int, int], None]) -> None:
        """`received` is told before each callback when DDS received the message and when that was sent, in ns of the
        two wall clocks, and after it that nothing is known of what rclpy's executor calls."""
        from rclpy.executors import SingleThreadedExecutor

        self._node = node
        self._received = received
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._subscriptions: list[tuple[int, Any]] = []
        """Each with the address that rclpy knows it by."""
        self._kinds: list[str] = []
        """Of what the node has, beside services."""
        self._others: list[Any] = []
        """Waitables, such as actions."""
        self._set: Any = None
        self._add: list[tuple[Any, Any]] = []
        """How each entity gets into the wait set, which is empty after each wait."""
        self._stale = True
        self._events_s = 0.0
        self._plain = not self._built()
        if not self._plain:
            # The node calls it for each entity that it makes or takes away.
            self._executor.wake = self._changed

    def _changed(self) -> None:
        self._stale = True

    def _built(self) -> bool:
        """Make the wait set. False where rclpy has none of the kind that is known here."""
        try:
            self._build()
        except (ImportError, AttributeError, TypeError):
            return False
        return True

    def _build(self) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        self._stale = False
        node = self._node
        subscriptions = list(node.subscriptions)
        self._subscriptions = [(each.handle.pointer, each) for each in subscriptions]
        guards, clients, services = list(node.guards), list(node.clients), list(node.services)
        # Events of DDS alone can wait for a second: they make each wait longer.
        counted = [(each, each.get_num_entities()) for each in node.waitables]
        counted = [(each, count) for each, count in counted if _beside_events(count)]
        self._others = [each for each, _ in counted]
        self._kinds = [kind for kind, there in (("client", clients), ("guard_condition", guards)) if there]
        own = (len(subscriptions), len(guards), 0, len(clients), len(services), 0)
        names = (*COUNTS, "num_events")
        more = [sum(getattr(count, name) for _, count in counted) for name in names]
        sizes = [size + others for size, others in zip(own, more, strict=True)]
        found = self._set = rclpy_implementation.WaitSet(*sizes, node.context.handle)
        self._add = [
            *((found.add_subscription, each.handle) for each in subscriptions),
            *((found.add_guard_condition, each.handle) for each in guards),
            *((found.add_client, each.handle) for each in clients),
            *((found.add_service, each.handle) for each in services),
            *((each.add_to_wait_set, found) for each in self._others),
        ]

    def turn(self, timeout_s: float) -> None:
        """Wait no longer than that, and call what is due."""
        if self._plain:
            self._executor.spin_once(timeout_sec=timeout_s)
            return
        if self._stale:
            self._build()
        awaited = any(not task.done() for task, _, _ in self._executor._tasks)
        self._set.clear_entities()
        for add, what in self._add:
            add(what)
        self._set.wait(int(min(timeout_s, AWAITED_S) * 1e9) if awaited else int(timeout_s * 1e9))
        ready = self._set.get_ready_entities
        if arrived := ready("subscription"):
            for pointer, subscription in self._subscriptions:
                if pointer in arrived:
                    self._take(subscription)
        now_s = monotonic()
        if awaited or ready("service") or now_s >= self._events_s or self._has_others():
            self._events_s = now_s + EVENTS_S
            self._executor.spin_once(timeout_sec=0)

    def _has_others(self) -> bool:
        return any(map(self._set.get_ready_entities, self._kinds)) or any(
            each.is_ready(self._set) for each in self._others
        )

    def _take(self, subscription: Any) -> None:
        """Take waiting messages, a few at most: others wait too."""
        for _ in range(MOST_AT_ONCE):
            with subscription.handle:
                found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if not found:
                return
            message, about = found
            self._received(about["received_timestamp"], about.get("source_timestamp", 0))
            subscription.callback(message)
            self._received(0, 0)

    def close(self) -> None:
        """Call nothing more."""
        self._set = None
        self._add.clear()
        self._executor.shutdown()


def _beside_events(count: Any) -> bool:
    """Whether there is more than events in it."""
    return any(getattr(count, name) for name in COUNTS)
