"""A gate at work, turn by turn: the test is its supervisor, its client and its port owner."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.procs.gate import main
from failstop.procs.gate.main import Gate
from failstop.shm import bell, claim, instance, layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.segment import Segment

from .stage import INCARNATION, MS, Stage

SESSION = 11


class Scene(Stage):
    """The gate on a stage, and one client of it."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(layout.GATE, directory)
        monkeypatch.setattr(main, "monotonic_ns", self.clock)
        self.runtime_dir = str(directory)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o600)
        self._fds["client_bell"] = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self._bells["port_owner_bell"] = EventBell.create()
        self._claims = claim.open_claims(instance.claims_path(self.runtime_dir), create=True)
        self.cause = self._views[layout.SUPERVISOR].latest_writer("cause")
        self._client = segment.attach_client_slot(self.name, 0, INCARNATION)
        self._reply = self.own.latest_reader("reply.0")
        self._made, self._trips = self.own.ring_reader("frames"), self.own.ring_reader("trips")
        self._number = 0
        self.asked: list[int] = []
        """Kinds of the frames that the last ask() led to."""
        self.ready(1)
        self.start_gate()
        assert claim.take(self._claims, 0)
        self._client.latest_writer("hello").write(records.pack_hello(SESSION, 0, 0, "test"))

    def client_slots(self) -> list[Segment]:
        return [segment.read_client_slot(self.name, index, INCARNATION) for index in range(layout.CLIENT_SLOTS)]

    def start_gate(self) -> None:
        """For the first time, or after its death."""
        self.gate = Gate(self)  # type: ignore[arg-type]

    def ready(self, word: int) -> None:
        """What the supervisor says of the service: 1 when motion may be enabled."""
        self._views[layout.SUPERVISOR].word("ready").set(word)

    def stop(self, epoch: int, since: int, standing: str, newest: str) -> None:
        """The supervisor raises the epoch."""
        self.cause.write(records.pack_cause(since, self.clock(), standing, newest), self.clock())
        self.raise_epoch(epoch)

    def reset(self) -> None:
        """The client's reset, before the gate looks at anything else."""
        self.gate.client_request(self.gate.clients.slots[0], 1, records.RESET, self.clock(), self.clock())

    def tick(self) -> str | None:
        """Time passes, a tick of the gate, which nobody rang; returns the latched reason."""
        self.clock.now_ns += 20 * MS
        self.beat(layout.SUPERVISOR)
        self.gate.turn({})
        return self.gate.core.latch

    def turn(self, elapsed_ns: int = 0, *, supervisor_beats: bool = True) -> list[int]:
        """Time passes, the client rings; returns the kinds of the frames that the gate made."""
        self.clock.now_ns += elapsed_ns
        if supervisor_beats:
            self.beat(layout.SUPERVISOR)
        self.gate.clients.rung(b"\0", self.clock())
        self.gate.turn({})
        next_ns = self.gate.loop.until_ns(self.clock(), self.gate.period_ns)
        assert next_ns > self.clock(), "a deadline was left behind: the loop would spin"
        found = []
        while entry := self._made.next():
            found.append(records.unpack_frame(entry[2])[1])
        return found

    def tripped(self) -> str:
        """The reason of a stop that it has published."""
        entry = self._trips.next()
        return records.unpack_stop(entry[2])[4] if entry else ""

    def request(self, verb: int, asked_ns: int | None = None) -> None:
        """The client asks, and does not ring."""
        self._number += 1
        request = records.pack_request(SESSION, self._number, verb)
        self._client.latest_writer("request").write(request, asked_ns or self.clock())

    def answer(self) -> tuple[bool, str]:
        entry = self._reply.read()
        assert entry is not None
        _, number, done, text = records.unpack_reply(entry[2])
        assert number == self._number
        return done, text

    def ask(self, verb: int, asked_ns: int | None = None) -> tuple[bool, str]:
        """The client asks and rings; returns the answer."""
        self.request(verb, asked_ns)
        self.asked = self.turn()
        return self.answer()

    def drive(self, vx_mps: float) -> list[int]:
        """A person's command; returns the kinds of the frames that it led to."""
        payload = records.pack_command(SESSION, vx_mps, 0.0, 0.0, True)
        self._client.latest_writer("command").write(payload, self.clock())
        return self.turn(10 * MS)

    def close(self) -> None:
        for fd in (self._claims, self._fds["client_bell"]):
            os.close(fd)
        self._client.close()
        super().close()
