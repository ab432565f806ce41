"""The stand-in's executor: one callback a turn, in the order subscriptions, services."""

from __future__ import annotations

import inspect
import time

from rclpy import types

LONGEST_S = 0.5


class ExternalShutdownException(Exception):
    pass


class SingleThreadedExecutor:
    def __init__(self) -> None:
        self._nodes: list = []
        self._tasks: list = []
        self._ready: list = []
        self._called: list = []

    def create_task(self, callback: object) -> None:
        """Have this called by the next turn, which does not wait any longer."""
        with self._nodes[0].wire.news:
            self._called.append(callback)
            self._nodes[0].wire.news.notify_all()

    def add_node(self, node: object) -> None:
        self._nodes.append(node)

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
        if any(service and service.alone for service, _, _ in self._tasks):
            # The node's own group is mutually exclusive: nothing else runs before that callback's end, not even what
            # would wake this executor up.
            return []
        found = [lambda task=task: self._go_on(*task) for task in self._tasks]
        found += self._called
        self._tasks, self._called = [], []
        for node in self._nodes:
            found += [lambda c=coroutine: self._go_on(None, None, c) for coroutine in node.begun]
            node.begun.clear()
            found += [lambda s=sub: self._deliver(s) for sub in node.subscriptions if sub.waiting]
            found += [lambda s=service: self._serve(s) for service in node.services if service.waiting]
        return found

    def _deliver(self, subscription: object) -> None:
        if subscription.waiting:
            subscription.callback(subscription.take())

    def _serve(self, service: object) -> None:
        header, fields = service.waiting.popleft()
        request = types.from_plain(f"{service.kind._name}_Request", fields)
        found = service.callback(request, service.kind.Response())
        if inspect.iscoroutine(found):
            self._go_on(service, header, found)
        else:
            service.send_response(found, header)

    def _go_on(self, service: object, header: tuple, coroutine: object) -> None:
        try:
            coroutine.send(None)
        except StopIteration as end:
            if service:
                service.send_response(end.value, header)
        else:
            self._tasks.append((service, header, coroutine))
            time.sleep(0.005)
