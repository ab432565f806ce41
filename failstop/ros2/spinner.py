"""Spinner: waits for messages and calls the node's callbacks, in one thread. It does what rclpy's executor does, but
faster.

rclpy's executor takes 0.7 ms per message. It makes a wait set, a task and a coroutine for each message, and asks every
entity of the node twice. This spinner keeps its wait set and reads messages itself. rclpy's executor still handles
services, actions, and callbacks that await something.

The spinner uses names that rclpy may change in any release: the executor's tasks and its wake(), which is replaced;
WaitSet of rclpy.impl; the node's guards, waitables and context.handle; three methods of a waitable; and an entity's
handle, its pointer and take_message(). If one of these names is missing or behaves differently, the spinner logs it
once and lets rclpy's executor do everything. This is slower, but nothing is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from time import monotonic
from typing import Any

AWAITED_S = 0.002
"""While a callback awaits something, how long to wait until it is called again, s."""
EVENTS_S = 1.0
"""How often to let rclpy handle DDS's events of the node (it logs them), and to look for entities that were added
without a notice, s."""
MOST_AT_ONCE = 10
COUNTS = ("num_subscriptions", "num_guard_conditions", "num_timers", "num_clients", "num_services")
"""The kinds of entities in a wait set, in its order. Events come last."""
PENDING = ("_pending_tasks", "_tasks")
"""The attributes in which an executor may keep its tasks. `_pending_tasks` is a mapping with the tasks as keys (since
rclpy #1469: Humble 3.3.21, Jazzy 7.1.9, Lyrical). `_tasks` is a list of (task, entity, node), in older versions."""
OTHERWISE = (ImportError, AttributeError, TypeError, ValueError, LookupError)
"""The errors that show that a part of rclpy has changed."""


class Spinner:
    """Calls the callbacks of one node, from one thread."""

    def __init__(self, node: Any, received: Callable[[int, int], None]) -> None:
        """`received(received_ns, sent_ns)` is called twice for each message: before its callback with the two times of
        the message (wall clock, ns), and after it with zeros. It is not called for the callbacks that rclpy's executor
        runs, so their times are not known."""
        from rclpy.executors import SingleThreadedExecutor

        self._node = node
        self._received = received
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._entities: list[list[Any]] = []
        self._subscriptions: list[tuple[int, Any]] = []
        """The subscriptions, each with the address by which rclpy identifies it."""
        self._kinds: list[str] = []
        """The kinds of entities that the node has, other than subscriptions and services."""
        self._others: list[Any] = []
        """The waitables, for example actions."""
        self._set: Any = None
        self._add: list[tuple[Any, Any]] = []
        """How to add each entity to the wait set, which is empty after each wait."""
        self._stale = True
        self._events_s = 0.0
        self._replaced = False
        """True if the executor's wake() was replaced."""
        self.plain = False
        """True if rclpy's executor does everything."""
        try:
            self._awaited()
            self._build()
            # The node calls wake() whenever an entity is created or destroyed.
            self._executor.wake = self._changed
            self._replaced = True
        except OTHERWISE as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        """Let rclpy's executor do everything from now on."""
        self.plain, self._set = True, None
        self._add.clear()
        if self._replaced:
            del self._executor.wake
            self._replaced = False
        text = f"this rclpy is newer or older than failstop knows ({type(error).__name__}: {error})"
        self._node.get_logger().warning(f"{text}, so its own executor calls everything: each message takes longer")

    def _changed(self) -> None:
        self._stale = True

    def _awaited(self) -> bool:
        """True if a callback awaits something. Raises AttributeError if the executor has none of PENDING."""
        executor = self._executor
        for name in PENDING:
            # Look it up each time, because an older executor replaces its list.
            if (found := getattr(executor, name, None)) is not None:
                return any(not task.done() for task in _tasks(found))
        raise AttributeError(f"{type(executor).__name__} has none of {', '.join(PENDING)}")

    def _found(self) -> list[list[Any]]:
        """The node's present entities: subscriptions, guard conditions, clients, services, waitables."""
        node = self._node
        return [*map(list, (node.subscriptions, node.guards, node.clients, node.services, node.waitables))]

    def _build(self) -> None:
        """Make the wait set. Raises one of OTHERWISE if a part of rclpy has changed."""
        from rclpy.impl.implementation_singleton import rclpy_implementation

        self._stale = False
        node = self._node
        self._entities = self._found()
        subscriptions, guards, clients, services, waitables = self._entities
        self._subscriptions = [(each.handle.pointer, each) for each in subscriptions]
        # Leave out DDS's events, because they can wait for a second and would make each wait longer.
        counted = [(each, each.get_num_entities()) for each in waitables]
        counted = [(each, count) for each, count in counted if _more_than_events(count)]
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
        """Wait for at most `timeout_s`, and call the callbacks that are due."""
        if not self.plain:
            try:
                arrived, leave = self._wait(timeout_s)
            except OTHERWISE as error:
                self._give_up(error)
        if self.plain:
            self._executor.spin_once(timeout_sec=timeout_s)
            return
        for subscription in arrived:
            self._receive(subscription)
        if leave:
            self._executor.spin_once(timeout_sec=0)

    def _wait(self, timeout_s: float) -> tuple[list[Any], bool]:
        """Wait for at most `timeout_s`. Returns the subscriptions that have messages, and True if rclpy's executor has
        something to do. Raises one of OTHERWISE. Call no code of the bridge here, because turn() treats these errors as
        a change in rclpy."""
        if self._stale:
            self._build()
        awaited = self._awaited()
        self._set.clear_entities()
        for add, what in self._add:
            add(what)
        self._set.wait(int(min(timeout_s, AWAITED_S) * 1e9) if awaited else int(timeout_s * 1e9))
        ready = self._set.get_ready_entities
        pointers = ready("subscription")
        arrived = [subscription for pointer, subscription in self._subscriptions if pointer in pointers]
        now_s = monotonic()
        leave = awaited or bool(ready("service")) or self._has_others()
        if now_s >= self._events_s:
            self._events_s, leave = now_s + EVENTS_S, True
            self._stale = self._stale or self._found() != self._entities
        return arrived, leave

    def _has_others(self) -> bool:
        return any(map(self._set.get_ready_entities, self._kinds)) or any(
            each.is_ready(self._set) for each in self._others
        )

    def _receive(self, subscription: Any) -> None:
        """Read up to MOST_AT_ONCE waiting messages of the subscription, and call its callback for each."""
        for _ in range(MOST_AT_ONCE):
            if self.plain:
                return
            try:
                with subscription.handle:
                    found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if not found:
                    return
            except OTHERWISE as error:
                self._give_up(error)
                return
            message, times = _message(found)
            if not times:
                self._give_up(TypeError("take_message() returns something else than (message, times)"))
            self._received(*(times or (0, 0)))
            subscription.callback(message)
            self._received(0, 0)

    def close(self) -> None:
        """Call no more callbacks."""
        self._set = None
        self._add.clear()
        self._executor.shutdown()


def _tasks(found: Any) -> Iterable[Any]:
    """The tasks of an executor, from its mapping or its list."""
    return list(found) if isinstance(found, Mapping) else [task for task, _, _ in found]


def _message(found: Any) -> tuple[Any, tuple[int, int] | None]:
    """Split the result of take_message() into the message and (time received, time sent). The times are None if they
    can't be read. Always return the message, because it has left its queue and may be a stop."""
    message, *about = found if isinstance(found, tuple) else (found,)
    try:
        return message, (int(about[0]["received_timestamp"]), int(about[0].get("source_timestamp", 0)))
    except OTHERWISE:
        return message, None


def _more_than_events(count: Any) -> bool:
    """True if the count includes entities other than events."""
    return any(getattr(count, name) for name in COUNTS)
