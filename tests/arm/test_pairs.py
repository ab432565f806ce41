"""The code does in the order of model/arm what its litmus tests do: here the processes themselves are watched."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.api.client import Client
from failstop.procs.stopper.main import HANG_NS
from failstop.shm import records
from failstop.shm.cell import LatestReader, LatestWriter, RingReader, RingWriter, cell_bytes
from failstop.shm.words import Barrier, Word
from tests.support import gate_scene, port_scene, stopper_scene
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene as SupervisorScene
from tests.support.telemetry_scene import Scene as TelemetryScene
from tests.support.watching_scene import Watching


class Trace:
    """What is done to the things that were given a name, and every barrier, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.names: dict[int, str] = {}
        self.done: list[str] = []
        self._note(monkeypatch, Barrier, "__call__", "barrier")
        for kind, method, verb in (
            (Word, "get", "load"),
            (Word, "set", "store"),
            (LatestReader, "read", "load"),
            (LatestWriter, "write", "store"),
        ):
            self._note(monkeypatch, kind, method, verb)

    def _note(self, monkeypatch: pytest.MonkeyPatch, kind: type, method: str, verb: str) -> None:
        real = getattr(kind, method)

        def noted(thing: object, *args: object) -> object:
            if verb == "barrier":
                self.done.append(verb)
            elif id(thing) in self.names:
                self.done.append(f"{verb} {self.names[id(thing)]}")
            return real(thing, *args)

        monkeypatch.setattr(kind, method, noted)

    def watch(self, **things: object) -> None:
        """From here on, nothing before."""
        self.names = {id(thing): name for name, thing in things.items()}
        self.done.clear()

    def has(self, *wanted: str) -> bool:
        """True when these follow one another, with other things between them at most."""
        rest = iter(self.done)
        return all(step in rest for step in wanted)


@pytest.fixture
def trace(monkeypatch: pytest.MonkeyPatch) -> Trace:
    return Trace(monkeypatch)


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[port_scene.Scene]:
    made = port_scene.Scene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[gate_scene.Scene]:
    made = gate_scene.Scene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def supervisor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SupervisorScene]:
    made = SupervisorScene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def watching(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watching]:
    made = Watching(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def telemetry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TelemetryScene]:
    made = TelemetryScene(tmp_path, monkeypatch)
    yield made
    made.close()


def test_cause_and_ready_before_the_epoch(supervisor: SupervisorScene, trace: Trace) -> None:
    supervisor.turn()
    own = supervisor.supervisor.epochs
    trace.watch(cause=own._latch_record, ready=own.ready_word, epoch=own._epoch_word)
    supervisor.notice()
    supervisor.turn()
    assert trace.has("store cause", "store ready", "barrier", "store epoch")


def test_the_epoch_before_cause_and_ready(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.turn()
    trace.watch(cause=gate.gate._latch, ready=gate.gate.requests._ready_word, epoch=gate.gate._epoch_word)
    gate.stop(2, "key1")
    gate.request(records.ENABLE)
    gate.tick()
    assert trace.done[:3] == ["load epoch", "barrier", "load cause"]
    gate.tick()
    gate.turn()
    assert "load ready" in trace.done, "and so before every later one"


def test_a_successor_sees_the_cause_of_the_epoch_that_it_sees(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.stop(2, "key1")
    trace.done.clear()
    gate.start_gate()
    trace.watch(cause=gate.gate._latch)
    gate.gate.follow_latch()
    assert trace.done[:2] == ["barrier", "load cause"]


def test_a_reset_s_time_before_its_number(gate: gate_scene.Scene, trace: Trace) -> None:
    requests = gate.gate.requests
    trace.watch(number=requests._asked_word, asked=requests._asked_ns_word)
    requests.ask_reset((None, 0, 0, gate.clock()))
    assert trace.has("store asked", "barrier", "store number")


def test_a_reset_s_number_before_its_time_and_what_became_of_it_before_that(
    supervisor: SupervisorScene, trace: Trace
) -> None:
    supervisor.turn()
    own = supervisor.supervisor.epochs
    supervisor.ask_reset()
    trace.watch(number=own._asked_word, asked=own._asked_ns_word, record=own._decided_record, decided=own._decided_word)
    supervisor.turn()
    assert trace.has("load number", "barrier", "load asked", "store record", "barrier", "store decided")


def test_a_decided_reset_before_the_latch_and_what_became_of_it(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.stop(2, "key1")
    gate.tick()
    requests = gate.gate.requests
    requests.ask_reset((None, 0, 0, gate.clock()))
    trace.watch(decided=requests._decided_word, latch=gate.gate._latch, record=requests._decided)
    gate.decide()
    assert trace.has("load decided", "barrier", "load latch", "barrier", "load record")


def test_moving_before_the_last_look_at_the_epoch(port: port_scene.Scene, trace: Trace) -> None:
    port.turn()
    port.put()
    trace.watch(moving=port.owner._moving_word, epoch=port.owner._epoch_word)
    assert port.turn() == port_scene.MOTION
    assert trace.has("store moving", "barrier", "load epoch")


def test_the_epoch_and_the_look_before_moving(watching: Watching, trace: Trace) -> None:
    trace.watch(moving=watching.supervisor._moving_word)
    watching.supervisor._motion()
    assert trace.done == ["barrier", "load moving"]


def test_the_stoppers_look_before_moving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trace: Trace) -> None:
    scene = stopper_scene.Scene(tmp_path, monkeypatch)
    try:
        trace.watch(moving=scene.stopper._port_owner_moving)
        monkeypatch.setattr(scene.stopper, "_starved", lambda *_: trace.done.append("look") or True)
        scene.written(HANG_NS // MS + 5, alive=False)
        assert trace.has("look", "barrier", "load moving")
        assert trace.done.index("load moving") > trace.done.index("barrier") > trace.done.index("look")
    finally:
        scene.close()


class Memory(bytearray):
    """A ring's memory; its stores are noted."""

    done: list[str]

    def __getitem__(self, where: slice) -> bytes:  # type: ignore[override]
        self.done.append("load")
        return bytes(super().__getitem__(where))

    def __setitem__(self, where: slice, data: bytes) -> None:  # type: ignore[override]
        self.done.append("store")
        super().__setitem__(where, data)


def test_an_entry_before_the_next(trace: Trace) -> None:
    memory = Memory(8 * cell_bytes(64))
    memory.done = trace.done
    writer = RingWriter(memory, 0, 64, 8, 1)
    trace.done.clear()
    writer.put(b"one")
    writer.put(b"two")
    assert trace.done == ["barrier", "store", "barrier", "store"]


def test_a_later_entry_before_the_second_look_at_a_torn_one(trace: Trace) -> None:
    memory = Memory(8 * cell_bytes(64))
    memory.done = trace.done
    reader = RingReader(memory, 0, 64, 8, 1)
    writer = RingWriter(memory, 0, 64, 8, 1)
    torn = cell_bytes(64)
    writer.put(b"torn")
    memory[torn : torn + 4] = b"torn"
    writer.put(b"whole")
    trace.done.clear()
    assert reader.next()[2] == b"whole"  # type: ignore[index]
    assert trace.done[: 1 + 8 + 2] == ["load"] * 9 + ["barrier", "load"]


def test_the_state_before_the_reply(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.turn()
    trace.watch(state=gate.gate._state, reply=gate.gate.requests._replies[0])
    gate.ask(records.ENABLE)
    assert trace.has("store state", "barrier", "store reply")


def test_the_reply_before_the_state(trace: Trace) -> None:
    class Reply:
        def read(self) -> tuple[int, int, bytes]:
            trace.done.append("load reply")
            return 1, 1, records.REPLY.pack(7, 3, True, "enabled", b"")

    client = Client.__new__(Client)
    client._session, client._reply = 7, Reply()  # type: ignore[assignment]
    reply = client.answer(3)
    assert reply is not None
    assert (reply.done, reply.text, reply.cause) == (True, "enabled", None)
    assert trace.done == ["load reply", "barrier"]


def test_the_verdict_before_its_time(telemetry: TelemetryScene, trace: Trace) -> None:
    own = telemetry.telemetry
    trace.watch(still=own._still_word, judged=own._judged_word)
    own._still.judged_ns, own._still.still_ns = 5, 3
    own._publish_still()
    assert trace.done == ["store still", "barrier", "store judged"]


def test_that_there_is_none_before_it_is_taken_back(telemetry: TelemetryScene, trace: Trace) -> None:
    own = telemetry.telemetry
    trace.watch(still=own._still_word, judged=own._judged_word)
    own._still.judged_ns = own._still.still_ns = 0
    own._publish_still()
    assert trace.done[:3] == ["store judged", "barrier", "store still"]


def test_the_time_before_the_verdict_and_again_after_it(supervisor: SupervisorScene, trace: Trace) -> None:
    supervisor.gate_stops()
    supervisor.turn()
    supervisor.answers(written_ns=supervisor.now_ns)
    supervisor.turn(MS)
    aftermath = supervisor.supervisor.aftermath
    trace.watch(still=aftermath._still, judged=aftermath._judged)
    supervisor.turn(MS)
    assert trace.has("load judged", "barrier", "load still", "barrier", "load judged")
