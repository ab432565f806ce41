"""Clients and the service beside them, over the real segments and claims of a temporary instance."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

from failstop.procs.gate.clients import ClientTable, Slot
from failstop.procs.gate.sources import Command
from failstop.procs.loop import Loop
from failstop.procs.world import World
from failstop.shm import claim, layout, records, segment
from failstop.shm.lifeline import EarlyNews, pid_namespace
from failstop.shm.segment import Segment

INCARNATION = 0x1234_5678_9ABC
NOW = 77_000_000_000
ALL = bytes(range(layout.CLIENT_SLOTS))
_numbers = itertools.count()


class Client:
    """A client of another process, as far as memory and claims go."""

    def __init__(
        self,
        service: Service,
        index: int,
        session: int,
        *,
        name: str = "test",
        pid: int | None = None,
        namespace: int | None = None,
    ) -> None:
        self.index = index
        self.session = session
        self.number = 0
        self._claims = claim.open_claims(str(service.claims))
        self.segment = segment.attach(service.name, f"client.{index}", INCARNATION, write=True)
        assert claim.take(self._claims, index)
        self.hello(session, name, os.getpid() if pid is None else pid, namespace)

    def hello(self, session: int, name: str, pid: int, namespace: int | None = None) -> None:
        """`namespace`: that of the pid; None for this process's own."""
        hello = records.HELLO.pack(session, pid, pid_namespace() if namespace is None else namespace, name)
        self.segment.latest_writer("hello").write(hello)

    def goodbye(self) -> None:
        self.segment.latest_writer("left").write(records.LEFT.pack(self.session))

    def command(self, vx: float = 0.1, *, session: int | None = None, t_ns: int = NOW) -> None:
        payload = records.COMMAND.pack(self.session if session is None else session, vx, 0.0, 0.0, False, "cmd_vel")
        self.segment.latest_writer("command").write(payload, t_ns)

    def request(self, verb: int = records.ENABLE, *, session: int | None = None) -> int:
        self.number += 1
        whose = self.session if session is None else session
        self.segment.latest_writer("request").write(records.REQUEST.pack(whose, self.number, verb))
        return self.number

    def leave(self) -> None:
        """The process dies: its claim goes, its memory stays."""
        os.close(self._claims)
        self.segment.close()
        self._claims = -1

    def close(self) -> None:
        if self._claims >= 0:
            self.leave()


class Service:
    """The service's side: eight client segments, the claims file, the table, and what it was told."""

    def __init__(self, directory: Path) -> None:
        self.name = f"c{os.getpid()}x{next(_numbers)}"
        self.claims = directory / "claims"
        os.close(claim.open_claims(str(self.claims), create=True))
        for index in range(layout.CLIENT_SLOTS):
            segment.create(self.name, f"client.{index}", INCARNATION).close()
        self.claims_fd = os.open(self.claims, os.O_RDONLY)
        self.loop = Loop(World())
        segment.create(self.name, "lifelines", INCARNATION).close()
        self._lifelines = segment.attach(self.name, "lifelines", INCARNATION, write=True)
        self.early = EarlyNews(self._lifelines)
        self.clients: list[Client] = []
        self._read: list[Segment] = []
        self.start()

    def start(self) -> None:
        """A gate starts, or starts again after its death."""
        slots = [segment.read_client_slot(self.name, i, INCARNATION) for i in range(layout.CLIENT_SLOTS)]
        self._read += slots
        self.requests = self
        self.table = ClientTable(slots, self.claims_fd, self.loop, self.early, self)  # type: ignore[arg-type]
        self.told: list[tuple[object, ...]] = []

    def join(
        self,
        index: int = 0,
        session: int = 11,
        *,
        name: str = "test",
        pid: int | None = None,
        namespace: int | None = None,
    ) -> Client:
        self.clients.append(Client(self, index, session, name=name, pid=pid, namespace=namespace))
        return self.clients[-1]

    def client_command(self, command: Command, now_ns: int) -> None:
        self.told.append(("command", command.session, command.velocity[0]))
        self.commanded = command

    def client_holds(self, slot: Slot, now_ns: int) -> None:
        self.held = (slot.latest("sensed"), slot.latest("interlocks"))

    def take(self, slot: Slot, number: int, verb: int, asked_ns: int, now_ns: int) -> None:
        self.told.append(("request", slot.session, number, verb))

    def client_gone(self, slot: Slot, now_ns: int) -> None:
        self.parted = slot.parted()
        self.told.append(("gone", slot.session))

    def look(self, hints: bytes = ALL) -> list[tuple[object, ...]]:
        """Ring the bell; returns what the listener was told."""
        self.told.clear()
        self.table.rung(hints, NOW)
        return list(self.told)

    def sessions(self) -> list[int]:
        return [slot.session for slot in self.table.active]

    def close(self) -> None:
        for client in self.clients:
            client.close()
        for slot in self.table.slots:
            if slot.life:
                slot.life.close()
        for read in (*self._read, self._lifelines):
            read.close()
        os.close(self.early.bell.fd)
        os.close(self.claims_fd)
        segment.unlink_all(self.name)
