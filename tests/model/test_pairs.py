"""The code does in the order of model/aarch64 what its litmus tests do: here the processes themselves are watched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from failstop.board.rrc.servos import bus_servo_move
from failstop.messages import layout, records
from failstop.policy.processes import HANG_NS
from failstop.procs.gate.requests import Request
from failstop.shm.cell import cell_bytes
from failstop_lab.machine.kernel import Machine
from tests.support import gate_scene, port_scene, stopper_scene
from tests.support.stage import MS, PortMachine
from tests.support.supervisor_scene import Scene as SupervisorScene
from tests.support.telemetry_scene import Scene as TelemetryScene


class Trace:
    """Accesses to the records that were given a name, and every barrier, in order: by the modules of one simulated
    machine, which end with it."""

    def __init__(self, scene: Any) -> None:
        self._machine: Machine = scene.machine
        self._names: dict[tuple[int, int], str] = {}
        self.done: list[str] = []
        words, cell = scene.load("failstop.shm.words"), scene.load("failstop.shm.cell")
        for kind, method, verb in (
            (words.Barrier, "__call__", ""),
            (words.Word, "get", "load"),
            (words.Word, "set", "store"),
            (cell.LatestReader, "read", "load"),
            (cell.LatestWriter, "write", "store"),
        ):
            setattr(kind, method, self._noted(getattr(kind, method), verb))

    def _noted(self, real: Callable[..., Any], verb: str) -> Callable[..., Any]:
        def noted(thing: Any, *args: object) -> Any:
            if not verb:
                self.done.append("barrier")
            elif name := self._names.get(place(thing)):
                self.done.append(f"{verb} {name}")
            return real(thing, *args)

        return noted

    def note_looks(self) -> None:
        """A process looks whether another is starved."""
        self._machine.at_seam = lambda thread, call, about: self.done.append("look") if call == "stat" else None

    def watch(self, **records: str) -> None:
        """From here on, nothing before. Each is a segment's record."""
        self._names = {self._place(record): name for name, record in records.items()}
        self.done.clear()

    def _place(self, record: str) -> tuple[int, int]:
        segment, _, name = record.partition(".")
        names: dict[str, Any] = self._machine.root.folder("/dev/shm").names
        file = next(file for path, file in names.items() if path.endswith(f".{segment}"))
        return id(file.mapped()), layout.SEGMENT_BY_NAME[segment].offsets[name]

    def has(self, *wanted: str) -> bool:
        """True when these follow one another, with other things between them at most."""
        rest = iter(self.done)
        return all(step in rest for step in wanted)


def place(thing: Any) -> tuple[int, int]:
    """The memory that a word or a record is in, and where."""
    if hasattr(thing, "_index"):
        return id(thing._words.obj), thing._index * 8
    return id(thing._view), thing._at


@pytest.fixture
def gate() -> gate_scene.Scene:
    return gate_scene.Scene()


@pytest.fixture
def supervisor() -> SupervisorScene:
    return SupervisorScene()


@pytest.fixture
def telemetry() -> TelemetryScene:
    return TelemetryScene()


def test_the_supervisor_stores_cause_and_ready_before_the_epoch(supervisor: SupervisorScene) -> None:
    supervisor.turn()
    trace = Trace(supervisor)
    trace.watch(cause="supervisor.latch", ready="supervisor.ready", epoch="supervisor.epoch")
    supervisor.notice()
    supervisor.turn()
    assert trace.has("store cause", "store ready", "barrier", "store epoch")


def test_the_gate_loads_the_epoch_before_cause_and_ready(gate: gate_scene.Scene) -> None:
    gate.turn()
    trace = Trace(gate)
    gate.stop("key1")
    gate.ask_for(records.ENABLE)
    trace.watch(cause="supervisor.latch", ready="supervisor.ready", epoch="supervisor.epoch")
    gate.tick()
    assert list(dict.fromkeys(trace.done))[:3] == ["load epoch", "barrier", "load cause"]
    gate.tick()
    gate.turn()
    assert "load ready" in trace.done, "and so before every later one"


def test_a_successor_sees_the_cause_of_the_epoch_that_it_sees(gate: gate_scene.Scene) -> None:
    gate.stop("key1")
    gate.start_gate()
    trace = Trace(gate)
    trace.watch(cause="supervisor.latch")
    gate.gate.follow_latch()
    assert trace.done[:2] == ["barrier", "load cause"]


def test_the_gate_stores_a_reset_s_time_before_its_number(gate: gate_scene.Scene) -> None:
    trace = Trace(gate)
    trace.watch(number="gate.resets_asked", asked="gate.reset_asked_ns")
    gate.gate.requests.ask_reset(Request(records.RESET, gate.clock()))
    assert trace.has("store asked", "barrier", "store number")


def test_the_supervisor_loads_a_reset_s_number_before_its_time(
    supervisor: SupervisorScene,
) -> None:
    supervisor.turn()
    supervisor.ask_reset()
    trace = Trace(supervisor)
    trace.watch(
        number="gate.resets_asked",
        asked="gate.reset_asked_ns",
        record="supervisor.reset",
        decided="supervisor.resets",
    )
    supervisor.turn()
    assert trace.has("load number", "barrier", "load asked", "store record", "barrier", "store decided")


def test_the_gate_loads_a_decided_reset_before_the_latch_and_what_became_of_it(gate: gate_scene.Scene) -> None:
    gate.stop("key1")
    gate.tick()
    gate.gate.requests.ask_reset(Request(records.RESET, gate.clock()))
    trace = Trace(gate)
    trace.watch(decided="supervisor.resets", latch="supervisor.latch", record="supervisor.reset")
    gate.decide()
    assert trace.has("load decided", "barrier", "load latch", "load record")


@pytest.mark.parametrize(
    ("kind", "frame"),
    [(records.MOTION, port_scene.MOTION), (records.ARM, bus_servo_move([(1, 500)], 40))],
    ids=["wheels", "arm"],
)
def test_the_port_owner_stores_moving_before_it_looks_at_time_and_epoch(kind: int, frame: bytes) -> None:
    """Held up in between, for however long, it writes nothing old."""
    arm: dict[str, Any] = {"joints.j1.servo": 1}
    port = port_scene.Scene(**arm)
    for ms in (0, 25, 100, 100):
        port.turn(ms * MS)
    port.put(frame, kind=kind)
    trace, main = Trace(port), port.load("failstop.procs.port_owner.main")
    look = main.monotonic_ns
    main.monotonic_ns = lambda: (trace.done.append("time"), look())[1]
    trace.watch(moving="port_owner.moving", epoch="supervisor.epoch")
    assert port.turn() == frame
    assert trace.has("store moving", "barrier", "time", "load epoch")


def test_the_supervisor_looks_at_a_silent_process_before_it_loads_moving(supervisor: SupervisorScene) -> None:
    supervisor.employ(layout.GATE)
    trace = Trace(supervisor)
    trace.note_looks()
    trace.watch(moving="port_owner.moving")
    supervisor.tick(2_000 * MS)
    assert trace.has("look", "barrier", "load moving")
    assert trace.done[trace.done.index("load moving") - 1] == "barrier"


def test_the_stopper_looks_at_the_port_owner_before_it_loads_moving() -> None:
    scene = stopper_scene.Scene()
    trace = Trace(scene)
    trace.watch(moving="port_owner.moving")
    trace.note_looks()
    scene.port_owner.starve()
    scene.written(HANG_NS // MS + 5, alive=False)
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


def traced_memory() -> tuple[Trace, Memory, Any]:
    """A ring's memory, and failstop.shm.cell."""
    machine = PortMachine()
    trace, memory = Trace(machine), Memory(8 * cell_bytes(64))
    memory.done = trace.done
    return trace, memory, machine.load("failstop.shm.cell")


def test_an_entry_is_stored_before_the_next() -> None:
    trace, memory, cell = traced_memory()
    writer = cell.RingWriter(memory, 0, 64, 8, 1)
    trace.done.clear()
    writer.put(b"one")
    writer.put(b"two")
    assert trace.done == ["barrier", "store", "barrier", "store"]


def test_a_later_entry_is_loaded_before_the_second_look_at_a_torn_one() -> None:
    trace, memory, cell = traced_memory()
    reader = cell.RingReader(memory, 0, 64, 8, 1)
    writer = cell.RingWriter(memory, 0, 64, 8, 1)
    torn = cell_bytes(64)
    writer.put(b"torn")
    memory[torn : torn + 4] = b"torn"
    writer.put(b"whole")
    trace.done.clear()
    assert reader.next()[2] == b"whole"
    assert trace.done[:4] == ["load", "load", "barrier", "load"], "the cell, then all of the ring in one copy"


def test_the_gate_stores_the_state_before_the_reply(gate: gate_scene.Scene) -> None:
    gate.turn()
    trace = Trace(gate)
    trace.watch(state="gate.state", reply="gate.reply.0")
    gate.ask(records.ENABLE)
    assert trace.has("store state", "barrier", "store reply")


def test_a_client_loads_the_reply_before_the_state() -> None:
    machine = PortMachine()
    trace = Trace(machine)

    class Reply:
        def read(self) -> tuple[int, int, bytes]:
            trace.done.append("load reply")
            return 1, 1, records.REPLY.pack(7, 3, True, 0, "enabled", b"")

    kind = machine.load("failstop.api.client").Client
    client = kind.__new__(kind)
    client._session, client._reply = 7, Reply()
    reply = client.answer(3)
    assert reply is not None
    assert (reply.done, reply.text, reply.cause) == (True, "enabled", None)
    assert trace.done == ["load reply", "barrier"]


def judges(telemetry: TelemetryScene, samples: int) -> Trace:
    """Handle the last of so many quiet samples."""
    trace = Trace(telemetry)
    for sample in range(samples):
        trace.watch(still="telemetry.still_ns", judged="telemetry.judged_ns")
        telemetry.imu(0.0, 0.0, 1.0, 0.1 * (sample % 2), 0.1 * (sample % 3), 0.25)
    return trace


def test_telemetry_stores_the_verdict_before_its_time(telemetry: TelemetryScene) -> None:
    trace = judges(telemetry, 200)
    stores = [step for step in trace.done if step != "barrier"]
    assert stores == ["store still", "store judged"] * (len(stores) // 2), "none takes a verdict back"
    assert trace.has("store still", "barrier", "store judged")


def test_telemetry_stores_that_there_is_no_verdict_before_it_takes_it_back(telemetry: TelemetryScene) -> None:
    trace = judges(telemetry, 1)
    assert trace.has("store judged", "barrier", "store still", "barrier", "store judged")


def test_the_supervisor_loads_the_time_before_the_verdict_and_again_after_it(supervisor: SupervisorScene) -> None:
    supervisor.gate_stops()
    supervisor.turn()
    supervisor.answers(written_ns=supervisor.now_ns)
    supervisor.turn(MS)
    trace = Trace(supervisor)
    trace.watch(still="telemetry.still_ns", judged="telemetry.judged_ns")
    supervisor.turn(MS)
    assert trace.has("load judged", "barrier", "load still", "barrier", "load judged")
