"""The gate's shell, turn by turn: what it hands to the port owner and the supervisor, and whom it refuses."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.procs.gate import main
from failstop.procs.gate.main import Gate
from failstop.shm import bell, claim, instance, layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import Heartbeat
from failstop.shm.lifeline import pid_namespace
from failstop.shm.segment import Segment
from failstop.supervisor.settings import Settings

MS = 1_000_000
RUN = 0x6A7E
SESSION = 11
_numbers = itertools.count()


class Scene:
    """A gate, with a clock that the test moves; the test is supervisor, client and port owner. It is its context."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.name = f"g{os.getpid()}x{next(_numbers)}"
        self.now_ns = 60_000 * MS
        monkeypatch.setattr(main, "monotonic_ns", lambda: self.now_ns)
        for spec in layout.SEGMENTS:
            segment.create(self.name, spec.name, RUN).close()
        self.runtime_dir = str(directory)
        self.settings = Settings({})
        self.own = segment.attach(self.name, layout.GATE, RUN, write=True)
        self.heartbeat = Heartbeat(self.own, os.getpid(), 0, self.now_ns)
        self.supervisor = segment.attach(self.name, layout.SUPERVISOR, RUN, write=True)
        self.supervisor.word("epoch").set(1)
        self.supervisor.word("ready").set(1)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o600)
        self._client_bell = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self._bells = {key: EventBell.create() for key in ("bell", "supervisor_bell", "port_owner_bell")}
        claims = instance.claims_path(self.runtime_dir)
        self._claims = claim.open_claims(claims, create=True)
        assert claim.take(self._claims, 0)
        self.client = segment.attach_client_slot(self.name, 0, RUN)
        self.client.latest_writer("hello").write(records.pack_hello(SESSION, os.getpid(), pid_namespace(), "test"))
        self.frames, self.trips = self.own.ring_reader("frames"), self.own.ring_reader("trips")
        self.gate = Gate(self)  # type: ignore[arg-type]
        self.turn()

    def fd(self, key: str) -> int:
        assert key == "client_bell"
        return self._client_bell

    def bell(self, key: str) -> EventBell:
        return self._bells[key]

    def segment(self, name: str) -> Segment:
        return segment.attach(self.name, name, RUN)

    def client_slots(self) -> list[Segment]:
        return [segment.read_client_slot(self.name, index, RUN) for index in range(layout.CLIENT_SLOTS)]

    def turn(self, elapsed_ns: int = 0, *, supervisor_beats: bool = True) -> list[int]:
        """Time passes, the client rings; returns the kinds of the frames that it made."""
        self.now_ns += elapsed_ns
        if supervisor_beats:
            self.supervisor.word("beat_ns").set(self.now_ns)
        self.gate.clients.rung(b"\0", self.now_ns)
        self.gate.turn({})
        found = []
        while entry := self.frames.next():
            found.append(records.unpack_frame(entry[2])[1])
        return found

    def tripped(self) -> str:
        entry = self.trips.next()
        return records.unpack_stop(entry[2])[4] if entry else ""

    def ask(self, verb: int, t_ns: int | None = None) -> tuple[bool, str]:
        writer = self.client.latest_writer("request")
        writer.write(records.pack_request(SESSION, 1, verb), self.now_ns if t_ns is None else t_ns)
        self.asked = self.turn()
        reply = self.own.latest_reader("reply.0").read()
        assert reply is not None
        _, _, done, text = records.unpack_reply(reply[2])
        return done, text

    def drive(self, vx_mps: float) -> list[int]:
        payload = records.pack_command(SESSION, vx_mps, 0.0, 0.0, True)
        self.client.latest_writer("command").write(payload, self.now_ns)
        return self.turn(10 * MS)

    def stop(self) -> None:
        """The supervisor raises the epoch."""
        stop = records.pack_cause(2, self.now_ns, "key1", "key1")
        self.supervisor.latest_writer("cause").write(stop, self.now_ns)
        self.supervisor.word("epoch").set(2)

    def close(self) -> None:
        for slot in self.gate.clients.slots:
            if slot.life:
                slot.life.close()
        for fd in (self._client_bell, self._claims, *(found.fd for found in self._bells.values())):
            os.close(fd)
        segment.unlink_all(self.name)


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.mark.parametrize("verb", [records.ENABLE, records.RESET])
def test_who_asked_before_the_last_stop_did_not_know_of_it(scene: Scene, verb: int) -> None:
    asked_ns = scene.now_ns - 1
    scene.stop()
    scene.turn()
    done, text = scene.ask(verb, asked_ns)
    assert not done
    assert text.startswith("asked before the last stop (key1)")
    assert scene.gate.core.latch == "key1"
    assert scene.ask(records.RESET)[0], "and now it does"


def test_a_stop_of_its_own_goes_to_the_port_owner_and_then_to_the_supervisor(scene: Scene) -> None:
    assert scene.ask(records.ENABLE)[0]
    assert records.MOTION in scene.drive(0.1)
    assert scene.drive(float("nan")) == [records.STOP]
    assert "is not finite" in scene.tripped()


def test_a_supervisor_that_is_silent_while_motion_is_enabled_is_a_stop(scene: Scene) -> None:
    lease_ns = scene.settings.ns("gate.lease_s")
    scene.turn(10 * lease_ns, supervisor_beats=False)
    assert scene.gate.core.latch is None, "nothing was enabled"
    scene.turn()
    assert scene.ask(records.ENABLE)[0]
    assert scene.turn(lease_ns, supervisor_beats=False) == []
    assert records.STOP in scene.turn(20 * MS, supervisor_beats=False)
    assert scene.tripped().startswith("supervisor hangs: silent for ")
    assert not scene.gate.core.enabled


def test_nobody_is_enabled_while_the_service_is_not_ready(scene: Scene) -> None:
    scene.supervisor.word("ready").set(0)
    assert scene.ask(records.ENABLE)[1].startswith("not ready: ")
    assert not scene.gate.core.enabled


def test_disabling_writes_a_stop(scene: Scene) -> None:
    scene.ask(records.ENABLE)
    scene.drive(0.1)
    scene.ask(records.DISABLE)
    assert scene.asked == [records.STOP]


def test_a_successor_starts_latched(scene: Scene) -> None:
    scene.stop()
    assert Gate(scene).core.latch == "key1"  # type: ignore[arg-type]
