"""Clients and the gate's table of them, which tells the test what it would tell the gate."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from failstop.messages import layout
from failstop.procs.gate.clients import OVER
from tests.support.gate_scene import CLAIMS, Client, Scene

NOW = 77_000_000_000
ALL = bytes(range(layout.CLIENT_SLOTS))
HEARD = ("sensed", "interlocks", "request", "command")


class Service:
    """The service's side: eight client slots, the claims file, the table, and what it was told."""

    def __init__(self) -> None:
        self.scene = Scene(clients=0)
        self.pid = self.scene.os.getpid()
        self.loop = self.scene.gate.loop
        self.early = self.scene.load("failstop.shm.lifeline").EarlyNews(self.scene.owned("lifelines"))
        self.claims_fd = self.scene.os.open(CLAIMS, os.O_RDONLY)
        self.start()

    def start(self) -> None:
        """A gate starts, or starts again after its death."""
        made = self.scene.load("failstop.procs.gate.clients").ClientTable
        self.table = made(self.scene.client_slots(), self.claims_fd, self.loop, self.early, HEARD)
        self.held: dict[str, tuple[object, ...]] = {}

    def join(
        self, index: int = 0, session: int = 11, *, name: str = "test", pid: int = -1, namespace: int | None = None
    ) -> Client:
        """`pid`: -1 for this process's own."""
        return self.scene.join(index, session, name, self.pid if pid < 0 else pid, namespace)

    def known(self, index: int = 0, session: int = 11, **said: Any) -> Client:
        """A client that the table has seen."""
        made = self.join(index, session, **said)
        self.look()
        return made

    def look(self, hints: bytes = ALL) -> list[tuple[object, ...]]:
        """Ring the bell; returns what it came to."""
        return self._hear(self.table.look(self.table.hinted(hints)))

    def tick(self) -> list[tuple[object, ...]]:
        """The gate's tick; returns the same."""
        return self._hear(self.table.look(self.table.active))

    def ended(self, ready: dict[int, int]) -> list[tuple[object, ...]]:
        """A wake-up by these descriptors; returns the same."""
        return self._hear(self.table.lives_ended(ready))

    def _hear(self, news: Iterable[Any]) -> list[tuple[object, ...]]:
        """`held`: the last assertions."""
        told: list[tuple[object, ...]] = []
        self.held.clear()
        for slot, record, values in news:
            if record == OVER:
                (self.parted,) = values
                told.append((record, slot.session))
            elif record == "request":
                told.append((record, slot.session, *values[1:]))
            elif record == "command":
                self.commanded = slot.command(*values)
                told.append((record, slot.session, self.commanded.velocity[0]))
            else:
                self.held[record] = values
        return told

    def sessions(self) -> list[int]:
        return [slot.session for slot in self.table.active]
