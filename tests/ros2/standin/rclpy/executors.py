"""The stand-in's executor: one callback a turn, in the order subscriptions, services.

It keeps its tasks where rclpy of one of two kinds does (RCLPY): "before" its change #1469, or "since".
"""

from __future__ import annotations

import inspect
import os
import time

from rclpy import types

LONGEST_S = 0.5
RCLPY = "FAILSTOP_STANDIN_RCLPY"


class ExternalShutdownException(Exception):
    pass


class Task:
    """A callback that awaits something."""

    def __init__(self, service: object, header: tuple | None, coroutine: object) -> None:
        self.service = service
        self.header = header
        self.coroutine = coroutine
        self._done = False

    def done(self) -> bool:
        return self._done

    def cancelled(self) -> bool:
        return False

    def step(self) -> None:
        try:
            awaited = self.coroutine.send(None)
        except StopIteration as end:
            self._done = True
            if self.service:
                self.service.send_response(end.value, self.header)
        else:
            if awaited is not None:
                raise TypeError(f"Expected coroutine to yield a Future or None, got: {type(awaited)}")


class _Executor:
    def __init__(self) -> None:
        self._nodes: list = []
        self._unfinished: list[Task] = []
        self._ready: list = []
        self._called: list = []

    def create_task(self, callback: object) -> None:
        """Have this called by the next turn, which does not wait any longer."""
        with self._nodes[0].wire.news:
            self._called.append(callback)
            self._nodes[0].wire.news.notify_all()

    def add_node(self, node: object) -> None:
        self._nodes.append(node)
        node.executor = self

    def wake(self) -> None:
        """The node calls it whenever an entity is created or destroyed."""
        with self._nodes[0].wire.news:
            self._nodes[0].wire.news.notify_all()

    def shutdown(self) -> None:
        self._nodes.clear()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        until_s = time.monotonic() + (LONGEST_S if timeout_sec is None else timeout_sec)
        self._ready = self._ready or self._wait(until_s)
        if self._ready:
            self._ready.pop(0)()

    def _wait(self, until_s: float) -> list:
        wire = self._nodes[0].wire
        while True:
            wire.touch()
            with wire.news:
                if found := self._found():
                    return found
                if time.monotonic() >= until_s:
                    return []
                wire.news.wait(max(0.0, until_s - time.monotonic()))

    def _found(self) -> list:
        if any(task.service and task.service.alone for task in self._unfinished):
            # The node's own group is mutually exclusive: nothing else runs before that callback's end, not even what
            # would wake this executor up.
            return []
        self._adopt()
        found = [lambda task=task: self._go_on(task) for task in self._unfinished]
        found += self._called
        self._unfinished, self._called = [], []
        for node in self._nodes:
            found += [lambda s=sub: self._deliver(s) for sub in node.subscriptions if sub.waiting]
            found += [lambda s=service: self._serve(s) for service in node.services if service.waiting]
        return found

    def _adopt(self) -> None:
        """Take over the coroutines that the nodes' callbacks began."""
        for node in self._nodes:
            self._unfinished += [Task(None, None, coroutine) for coroutine in node.begun]
            node.begun.clear()

    def _deliver(self, subscription: object) -> None:
        if subscription.waiting:
            subscription.callback(subscription.take())

    def _serve(self, service: object) -> None:
        header, fields = service.waiting.popleft()
        request = types.from_plain(f"{service.kind._name}_Request", fields)
        found = service.callback(request, service.kind.Response())
        if inspect.iscoroutine(found):
            self._go_on(Task(service, header, found))
        else:
            service.send_response(found, header)

    def _go_on(self, task: Task) -> None:
        task.step()
        if not task.done():
            self._unfinished.append(task)
            time.sleep(0.005)

    def _all(self) -> list[Task]:
        self._adopt()
        return list(self._unfinished)


class Before(_Executor):
    @property
    def _tasks(self) -> list[tuple]:
        return [(task, None, None) for task in self._all()]


class Since(_Executor):
    @property
    def _pending_tasks(self) -> dict[Task, None]:
        return dict.fromkeys(self._all())


SingleThreadedExecutor = Before if os.environ.get(RCLPY) == "before" else Since
