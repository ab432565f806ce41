"""Clients and the gate's table of them, which tells the test what it would tell the gate."""

from __future__ import annotations

import os
from typing import Any

from failstop.messages import layout
from tests.support.gate_scene import CLAIMS, Client, Scene

NOW = 77_000_000_000
ALL = bytes(range(layout.CLIENT_SLOTS))


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
        self.requests = self
        made = self.scene.load("failstop.procs.gate.clients").ClientTable
        self.table = made(self.scene.client_slots(), self.claims_fd, self.loop, self.early, self)
        self.told: list[tuple[object, ...]] = []

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

    def client_command(self, command: Any, now_ns: int) -> None:
        self.told.append(("command", command.session, command.velocity[0]))
        self.commanded = command

    def client_holds(self, slot: Any, now_ns: int) -> None:
        self.held = (slot.latest("sensed"), slot.latest("interlocks"))

    def take(self, slot: Any, number: int, verb: int, asked_ns: int, now_ns: int) -> None:
        self.told.append(("request", slot.session, number, verb))

    def client_gone(self, slot: Any, now_ns: int) -> None:
        self.parted = slot.parted()
        self.told.append(("gone", slot.session))

    def look(self, hints: bytes = ALL) -> list[tuple[object, ...]]:
        """Ring the bell; returns what the listener was told."""
        self.told.clear()
        self.table.rung(hints, NOW)
        return list(self.told)

    def tick(self) -> list[tuple[object, ...]]:
        """The gate's tick; returns the same."""
        self.told.clear()
        self.table.look_at_active(NOW)
        return list(self.told)

    def ended(self, ready: dict[int, int]) -> list[tuple[object, ...]]:
        """A wake-up by these descriptors; returns the same."""
        self.told.clear()
        self.table.lives_ended(ready, NOW)
        return list(self.told)

    def sessions(self) -> list[int]:
        return [slot.session for slot in self.table.active]
