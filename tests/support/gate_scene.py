"""A gate at work, turn by turn: the test is its supervisor, its client and its port owner."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.policy import causes
from failstop.policy.reply import unpack
from failstop.procs.gate.main import Gate
from failstop.shm import bell, claim, instance, layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.packing import Note
from failstop.shm.segment import Segment
from failstop.supervisor.latch import Latch
from failstop.supervisor.stops import Stop
from tests.support.stage import INCARNATION, MS, Stage
from tests.support.why import said, why

SESSION = 11


class GateStage(Stage):
    """What a gate finds when it starts: its supervisor's records, its clients' slots and bell."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(layout.GATE, directory)
        self.runtime_dir = str(directory)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o600)
        self._fds["client_bell"] = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self._bells["port_owner_bell"] = EventBell.create()
        self._claims = claim.open_claims(instance.claims_path(self.runtime_dir), create=True)
        self._clients: list[Segment] = []
        supervisor = self.views[layout.SUPERVISOR]
        self._latch_record, self._reset_record = supervisor.latest_writer("latch"), supervisor.latest_writer("reset")
        self._resets_word = supervisor.word("resets")
        self._made, self._told = self.own.ring_reader("frames"), self.own.ring_reader("notes")

    def ready(self, word: int) -> None:
        """What the supervisor says of the service: 1 when motion may be enabled."""
        self.views[layout.SUPERVISOR].word("ready").set(word)

    def start_gate(self) -> None:
        """For the first time, or after its death."""
        self.gate = Gate(self)  # type: ignore[arg-type]

    def told(self) -> list[str]:
        """What people were told since the last look."""
        found = []
        while entry := self._told.next():
            found.append(Note.unpack(entry[2]).text)
        return found

    def join(self, session: int, who: str) -> Segment:
        """A client takes the next slot."""
        index = len(self._clients)
        found = segment.attach(self.name, f"client.{index}", INCARNATION, write=True)
        assert claim.take(self._claims, index)
        found.latest_writer("hello").write(records.HELLO.pack(session, 0, 0, who))
        self._clients.append(found)
        return found

    def close(self) -> None:
        for fd in (self._claims, self._fds["client_bell"]):
            os.close(fd)
        for client in self._clients:
            client.close()
        super().close()


class Scene(GateStage):
    """The gate on a stage, and one client of it."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self.latch = Latch()
        self._reply = self.own.latest_reader("reply.0")
        self._stops = self.own.ring_reader("stops")
        self.session, self._number = SESSION, 0
        self.asked: list[int] = []
        """Kinds of the frames that the last ask() led to."""
        self.ready(1)
        self.start_gate()
        self._client = self.join(SESSION, "test")

    def succeed(self, session: int) -> None:
        """Another session has the client's slot, and counts its requests from the first again."""
        self.session, self._number = session, 0
        self._client.latest_writer("hello").write(records.HELLO.pack(session, 0, 0, "heir"))

    def pad_resets(self) -> None:
        """The reset of the gamepad, which telemetry passes on."""
        request = records.PAD_REQUEST.pack(records.PAD_RESET, b"")
        self.views[layout.TELEMETRY].ring_writer("pad_requests").put(request)

    def stop(self, epoch: int, text: str) -> None:
        """The supervisor raises the epoch."""
        self.latch.add([Stop(self.clock(), layout.SUPERVISOR, why(text))], epoch, self.clock())
        self._latch_record.write(self.latch.as_record(), self.clock())
        self.raise_epoch(epoch)

    def decide(self) -> None:
        """The supervisor hears of a reset that the gate passes on, and the gate of what became of it."""
        while (number := self.own.word("resets_asked").get()) != self._resets_word.get():
            reply = self.latch.reset(self.gate.epoch, self.own.word("reset_asked_ns").get())
            if self.latch.newest:
                self._latch_record.write(self.latch.as_record(), self.clock())
            self._reset_record.write(reply.pack(0, number), self.clock())
            self._resets_word.set(number)
            self.gate.turn({})

    def tick(self) -> str | None:
        """Time passes, a tick of the gate, which nobody rang; returns the latched reason."""
        self.clock.now_ns += 20 * MS
        self.beat(layout.SUPERVISOR)
        self.gate.turn({})
        self.decide()
        return self.latched()

    def latched(self) -> str | None:
        """What the gate takes to be latched."""
        return said(self.gate.core.latch) if self.gate.core.latch else None

    def turn(self, elapsed_ns: int = 0, *, supervisor_beats: bool = True) -> list[int]:
        """Time passes, the client rings; returns the kinds of the frames that the gate made."""
        self.clock.now_ns += elapsed_ns
        if supervisor_beats:
            self.beat(layout.SUPERVISOR)
        self.gate.clients.rung(b"\0", self.clock())
        self.gate.turn({})
        self.decide()
        assert self.gate.loop.due_ns() > self.clock(), "a timer was left behind: the loop would spin"
        found = []
        while entry := self._made.next():
            found.append(records.FRAME.unpack(entry[2])[1])
        return found

    def stopped(self) -> str:
        """The reason of a stop that it has published."""
        entry = self._stops.next()
        return str(causes.read(records.STOPPED.unpack(entry[2])[3])) if entry else ""

    def request(self, verb: int, asked_ns: int | None = None) -> None:
        """The client asks, and does not ring."""
        self._number += 1
        request = records.REQUEST.pack(self.session, self._number, verb)
        self._client.latest_writer("request").write(request, asked_ns or self.clock())

    def replied(self) -> tuple[int, bool, str]:
        """The last reply to the client: to which request, done, the text."""
        entry = self._reply.read()
        assert entry is not None
        _, number, reply = unpack(entry[2])
        return number, bool(reply.done), reply.text.replace(records.CAUSE, said(reply.cause) if reply.cause else "")

    def no_reply(self) -> bool:
        """True when nothing was said to the client."""
        return self._reply.read() is None

    def answer(self) -> tuple[bool, str]:
        number, done, text = self.replied()
        assert number == self._number
        return done, text

    def own_supervisor(self) -> Segment:
        """The supervisor's segment, which is the test's to write."""
        return self.views[layout.SUPERVISOR]

    def ask(self, verb: int, asked_ns: int | None = None) -> tuple[bool, str]:
        """The client asks and rings; returns the answer."""
        self.request(verb, asked_ns)
        self.asked = self.turn()
        return self.answer()

    def drive(self, vx_mps: float) -> list[int]:
        """A person's command; returns the kinds of the frames that it led to."""
        self.command(vx_mps)
        return self.turn(10 * MS)

    def limit(self, percent: int) -> None:
        """The client leaves a speed limit for its request."""
        payload = records.SPEED_LIMIT.pack(self.session, percent)
        self._client.latest_writer("speed_limit").write(payload, self.clock())

    def saw(self, epoch: int) -> None:
        """The client leaves the epoch that its person saw for its request."""
        self._client.latest_writer("seen").write(records.SEEN.pack(self.session, epoch), self.clock())

    def command(self, vx_mps: float) -> None:
        """A person's command, without a ring."""
        payload = records.COMMAND.pack(self.session, vx_mps, 0.0, 0.0, True, "cmd_vel")
        self._client.latest_writer("command").write(payload, self.clock())
