"""The stand-in's wait set: as small as rclpy's, and as strict about how many entities it has room for."""

from __future__ import annotations

import time
from types import SimpleNamespace

KINDS = ("subscription", "guard_condition", "timer", "client", "service", "event")


class WaitSet:
    def __init__(self, *sizes_and_context: object) -> None:
        *sizes, self._context = sizes_and_context
        self._room = dict(zip(KINDS, sizes, strict=True))
        self._entities: dict[str, list] = {}
        self._ready: dict[str, list[int]] = {}
        self.clear_entities()

    def clear_entities(self) -> None:
        self._entities = {kind: [] for kind in KINDS}

    def _add(self, kind: str, handle: object) -> None:
        assert len(self._entities[kind]) < self._room[kind], f"no room for another {kind}"
        self._entities[kind].append(handle)

    def add_subscription(self, handle: object) -> None:
        self._add("subscription", handle)

    def add_guard_condition(self, handle: object) -> None:
        self._add("guard_condition", handle)

    def add_client(self, handle: object) -> None:
        self._add("client", handle)

    def add_service(self, handle: object) -> None:
        self._add("service", handle)

    def wait(self, timeout_ns: int) -> None:
        wire = self._context.wire
        until_s = time.monotonic() + timeout_ns / 1e9
        with wire.news:
            while not any(self._look().values()) and time.monotonic() < until_s:
                wire.news.wait(max(0.0, until_s - time.monotonic()))
        wire.touch()
        # What did not get ready is not in the set any more.
        self._entities = {kind: [] for kind in KINDS}

    def _look(self) -> dict[str, list[int]]:
        self._ready = {
            kind: [handle.pointer for handle in handles if handle.waiting] for kind, handles in self._entities.items()
        }
        return self._ready

    def get_ready_entities(self, kind: str) -> list[int]:
        return self._ready[kind]


rclpy_implementation = SimpleNamespace(WaitSet=WaitSet)
