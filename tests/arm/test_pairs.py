"""The code does in the order of model/arm what its litmus tests do: here the processes themselves are watched."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

import pytest

from failstop.api.client import Client
from failstop.board.servos import bus_servo_move
from failstop.procs.stopper.main import HANG_NS
from failstop.shm import records
from failstop.shm.cell import LatestReader, LatestWriter, RingReader, RingWriter, cell_bytes
from failstop.shm.segment import Segment
from failstop.shm.words import Barrier, Word
from failstop.supervisor.main import HELD_UP_NS
from tests.support import gate_scene, port_scene, stopper_scene
from tests.support.arm_settings import ARM
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene as SupervisorScene
from tests.support.telemetry_scene import Scene as TelemetryScene
from tests.support.watching_scene import Watching


class Trace:
    """What is done to the records that were given a name, and every barrier, in order; the test's own part too, which
    plays the other processes. A trace must be there before the scene."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._monkeypatch = monkeypatch
        self._records: dict[int, tuple[str, object]] = {}
        self._names: dict[str, str] = {}
        self.done: list[str] = []
        for method in ("word", "latest_reader", "latest_writer"):
            self._make(method)
        self._before(Barrier, "__call__", lambda _: self.done.append("barrier"))
        for kind, method, verb in (
            (Word, "get", "load"),
            (Word, "set", "store"),
            (LatestReader, "read", "load"),
            (LatestWriter, "write", "store"),
        ):
            self._before(kind, method, lambda thing, *_, verb=verb: self._note(verb, thing))

    def _before(self, kind: type, method: str, note: Callable[..., object]) -> None:
        real = getattr(kind, method)

        def noted(*args: object) -> object:
            note(*args)
            return real(*args)

        self._monkeypatch.setattr(kind, method, noted)

    def _make(self, method: str) -> None:
        real = getattr(Segment, method)

        def made(segment: Segment, record: str) -> object:
            thing = real(segment, record)
            self._records[id(thing)] = f"{segment.spec.name}.{record}", thing
            return thing

        self._monkeypatch.setattr(Segment, method, made)

    def _note(self, verb: str, thing: object) -> None:
        record, _ = self._records.get(id(thing), ("", None))
        if record in self._names:
            self.done.append(f"{verb} {self._names[record]}")

    def watch(self, **records: str) -> None:
        """From here on, nothing before. The records as segment.record."""
        self._names = {record: name for name, record in records.items()}
        self.done.clear()

    def has(self, *wanted: str) -> bool:
        """True when these follow one another, with other things between them at most."""
        rest = iter(self.done)
        return all(step in rest for step in wanted)


@pytest.fixture
def trace(monkeypatch: pytest.MonkeyPatch) -> Trace:
    return Trace(monkeypatch)


def staged(make: Callable[[Path, pytest.MonkeyPatch], Any]) -> Any:
    """A fixture that is this scene, traced from its start."""

    @pytest.fixture
    def fixture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trace: Trace) -> Iterator[Any]:
        with closing(make(tmp_path, monkeypatch)) as made:
            yield made

    return fixture


class ArmPort(port_scene.Scene):
    """Of a robot with an arm."""

    changed: ClassVar[dict[str, object]] = ARM


port, arm_port = staged(port_scene.Scene), staged(ArmPort)
gate, stopper = staged(gate_scene.Scene), staged(stopper_scene.Scene)
supervisor, watching, telemetry = staged(SupervisorScene), staged(Watching), staged(TelemetryScene)


def test_cause_and_ready_before_the_epoch(supervisor: SupervisorScene, trace: Trace) -> None:
    supervisor.turn()
    trace.watch(cause="supervisor.latch", ready="supervisor.ready", epoch="supervisor.epoch")
    supervisor.notice()
    supervisor.turn()
    assert trace.has("store cause", "store ready", "barrier", "store epoch")


def test_the_epoch_before_cause_and_ready(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.turn()
    gate.stop(2, "key1")
    gate.request(records.ENABLE)
    trace.watch(cause="supervisor.latch", ready="supervisor.ready", epoch="supervisor.epoch")
    gate.tick()
    assert trace.done[:3] == ["load epoch", "barrier", "load cause"]
    gate.tick()
    gate.turn()
    assert "load ready" in trace.done, "and so before every later one"


def test_a_successor_sees_the_cause_of_the_epoch_that_it_sees(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.stop(2, "key1")
    gate.start_gate()
    trace.watch(cause="supervisor.latch")
    gate.gate.follow_latch()
    assert trace.done[:2] == ["barrier", "load cause"]


def test_a_reset_s_time_before_its_number(gate: gate_scene.Scene, trace: Trace) -> None:
    trace.watch(number="gate.resets_asked", asked="gate.reset_asked_ns")
    gate.gate.requests.ask_reset((None, 0, 0, gate.clock()))
    assert trace.has("store asked", "barrier", "store number")


def test_a_reset_s_number_before_its_time_and_what_became_of_it_before_that(
    supervisor: SupervisorScene, trace: Trace
) -> None:
    supervisor.turn()
    supervisor.ask_reset()
    asked = {"number": "gate.resets_asked", "asked": "gate.reset_asked_ns"}
    trace.watch(**asked, record="supervisor.reset", decided="supervisor.resets")
    supervisor.turn()
    assert trace.has("load number", "barrier", "load asked", "store record", "barrier", "store decided")


def test_a_decided_reset_before_the_latch_and_what_became_of_it(gate: gate_scene.Scene, trace: Trace) -> None:
    gate.stop(2, "key1")
    gate.tick()
    gate.gate.requests.ask_reset((None, 0, 0, gate.clock()))
    trace.watch(decided="supervisor.resets", latch="supervisor.latch", record="supervisor.reset")
    gate.decide()
    assert trace.has("store decided", "load decided", "barrier", "load latch", "barrier", "load record")


def test_moving_before_the_last_look_at_the_epoch(port: port_scene.Scene, trace: Trace) -> None:
    port.turn()
    port.put()
    trace.watch(moving="port_owner.moving", epoch="supervisor.epoch")
    assert port.turn() == port_scene.MOTION
    assert trace.has("store moving", "barrier", "load epoch")


def test_moving_before_the_last_look_at_the_epoch_for_an_arm_s_move_too(arm_port: ArmPort, trace: Trace) -> None:
    for _ in range(4):
        arm_port.turn(100 * MS)
    move = bus_servo_move([(1, 500)], 40)
    arm_port.put(move, kind=records.ARM)
    trace.watch(moving="port_owner.moving", epoch="supervisor.epoch")
    assert arm_port.turn() == move
    assert trace.has("store moving", "barrier", "load epoch", "store moving")


def test_the_epoch_and_the_look_before_moving(watching: Watching, trace: Trace) -> None:
    watching.supervisor.status.ever = True
    trace.watch(moving="port_owner.moving")
    watching.pass_time(HELD_UP_NS)
    assert trace.done[:2] == ["barrier", "load moving"]


def test_the_stoppers_look_before_moving(stopper: stopper_scene.Scene, trace: Trace) -> None:
    trace.watch(moving="port_owner.moving")
    stopper.world.play("starved", lambda *_: trace.done.append("look") or True)
    stopper.written(HANG_NS // MS + 5, alive=False)
    assert trace.has("look", "barrier", "load moving")
    assert trace.done.index("load moving") > trace.done.index("barrier") > trace.done.index("look")


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
    trace.watch(state="gate.state", reply="gate.reply.0")
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


def test_the_verdict_before_its_time_and_that_there_is_none_before_it_is_taken_back(
    telemetry: TelemetryScene, trace: Trace
) -> None:
    trace.watch(still="telemetry.still_ns", judged="telemetry.judged_ns")
    telemetry.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert trace.has("store judged", "barrier", "store still")
    for number in range(200):
        telemetry.imu(0.0, 0.0, 1.0, 9.0 * (number % 2), 0.0, 0.0)  # it turns
    trace.done.clear()
    telemetry.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert trace.has("store still", "barrier", "store judged")
    assert trace.done.index("store still") < trace.done.index("store judged")


def test_the_time_before_the_verdict_and_again_after_it(supervisor: SupervisorScene, trace: Trace) -> None:
    supervisor.gate_stops()
    supervisor.turn()
    supervisor.answers(written_ns=supervisor.now_ns)
    supervisor.turn(MS)
    trace.watch(still="telemetry.still_ns", judged="telemetry.judged_ns")
    supervisor.turn(MS)
    assert trace.has("load judged", "barrier", "load still", "barrier", "load judged")
