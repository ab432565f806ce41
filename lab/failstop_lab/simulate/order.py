"""Order: whether each process has seen shared memory in an order that the protocol may rely on, by the pairs of
model/aarch64/README.md. The board judges what wheels do; of most pairs that go wrong it shows nothing for thousands of
runs, and of some nothing ever, since they are of what people are told.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

from failstop.messages import layout
from failstop_lab.machine.mapped import Mapped
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.process import Process, Thread
from failstop_lab.simulate.witness import SERVICE_PROCESSES, Witness


@dataclass(frozen=True)
class Pair:
    """A reader that has seen `then` sees `first` no older than it was when that was stored. `reader`: "": a client."""

    name: str
    first: str
    then: str
    reader: str


PAIRS = (
    Pair("cause", "supervisor.latch", "supervisor.epoch", "gate"),
    Pair("ready", "supervisor.ready", "supervisor.epoch", "gate"),
    Pair("still", "telemetry.still_ns", "telemetry.judged_ns", "supervisor"),
    Pair("unknown", "telemetry.judged_ns", "telemetry.still_ns", "supervisor"),
    *(Pair("reply", "gate.state", f"gate.reply.{slot}", "") for slot in range(layout.CLIENT_SLOTS)),
    Pair("reset asked", "gate.reset_asked_ns", "gate.resets_asked", "supervisor"),
    Pair("reset decided", "supervisor.reset", "supervisor.resets", "gate"),
)
MOVING, EPOCH = "port_owner.moving", "supervisor.epoch"
"""Each of two processes stores one and then loads the other: one of them must see the other's."""
NAMED = {each for pair in PAIRS for each in (pair.first, pair.then)} | {MOVING, EPOCH}


@dataclass
class ServiceRun:
    """The watched memory of one run of the service."""

    records: dict[str, Watched] = field(default_factory=dict)
    """By name."""
    moving: tuple[int, int] | None = None
    """The port owner's last store of MOVING, and the store of EPOCH that it saw next; -1: it has not looked."""
    raised: tuple[int, int] | None = None
    """The supervisor's last store of EPOCH, and the store of MOVING that it saw next; -1: it has not looked."""


@dataclass
class Watched:
    """A watched place of one segment: when its stores were made, and what each reader saw last."""

    name: str
    run: ServiceRun = field(repr=False)
    made: list[int] = field(default_factory=list)
    seen: dict[int, int] = field(default_factory=dict)
    """By process: the newest store that it has seen; 0: none."""


def shared_path(machine: WeakMachine, node: Any) -> str:
    """The path of a file of shared memory, by its Node; empty: it is none."""
    files = machine.root.folder("/dev/shm").names.items()
    return next((path for path, file in files if file is node), "")


class Order:
    """Watches the loads of a machine's processes."""

    def __init__(self, machine: WeakMachine, witness: Witness) -> None:
        self.machine, self._witness = machine, witness
        self._files: dict[int, dict[int, Watched]] = {}
        """The watched places of each file, by the number of its Node."""
        self._runs: dict[str, ServiceRun] = {}
        self.asks = False
        """The supervisor asks whether anything moves, and will spare a process by the answer; or the stopper does."""
        self.starved_since: dict[int, int] = {}
        """By the pid of who looked at a starved port owner and has not asked since: the newest store then."""
        machine.on_store, machine.on_load = self._stored, self._loaded

    def _record(self, mapped: Mapped, at: int) -> Watched | None:
        found = self._files.get(mapped.node.number)
        if found is None:
            found = self._files[mapped.node.number] = self._watched(mapped)
        return found.get(at)

    def _watched(self, mapped: Mapped) -> dict[int, Watched]:
        """The watched records of a file by their places: latest records have two cells, and are read from the first."""
        path = shared_path(self.machine, mapped.node)
        segment = path.rpartition(".")[2]
        spec = layout.SEGMENT_BY_NAME.get(segment)
        if spec is None:
            return {}
        found: dict[int, Watched] = {}
        own = self._runs.setdefault(path.rpartition(".")[0], ServiceRun())
        for name, begin in spec.offsets.items():
            if (whole := f"{segment}.{name}") in NAMED:
                record = own.records[whole] = Watched(whole, own)
                size = spec.records[name].size()
                found[begin] = found[begin + (size // 2 if spec.records[name].kind == "latest" else 0)] = record
        return found

    def _stored(self, thread: Thread, mapped: Mapped, at: int, made: int) -> None:
        if (record := self._record(mapped, at)) is None:
            return
        record.made.append(made)
        if record.name == MOVING and mapped.data[at]:
            record.run.moving = made, -1
        elif record.name == EPOCH:
            record.run.raised = made, -1

    def _loaded(self, thread: Thread, mapped: Mapped, at: int, stamp: int) -> None:
        if (record := self._record(mapped, at)) is None:
            return
        unseen = self.machine.unseen(stamp)
        saw = next((made for made in reversed(record.made) if made not in unseen), 0)
        process = thread.process
        record.seen[process.pid] = saw
        if self.asks and record.name == MOVING:
            self._judge_look(process, record, saw)
        self._judge_both(process.name, record, saw)
        reader = process.name if process.name in SERVICE_PROCESSES else ""
        for pair in PAIRS:
            if pair.first == record.name and pair.reader == reader and pair.then in record.run.records:
                then = record.run.records[pair.then].seen.get(process.pid, 0)
                before = bisect_left(record.made, then)
                if then and before and saw < record.made[before - 1]:
                    self._witness.wrong(f"{process.name} has seen {pair.then}, and not the {pair.first} from before it")

    def looked(self, *, starved: bool) -> None:
        """The process that runs has looked why the port owner is silent."""
        pid = self.machine.caller().process.pid
        self.starved_since.pop(pid, None)
        if starved:
            self.starved_since[pid] = self.machine.stamp

    def _judge_look(self, process: Process, record: Watched, saw: int) -> None:
        """A starved port owner has said whether it moves before it was starved."""
        since = self.starved_since.pop(process.pid, None)
        if since is not None and saw < max((made for made in record.made if made <= since), default=0):
            self._witness.wrong(f"{process.name} has seen the port owner starved, and not the {MOVING} from before it")

    def _judge_both(self, name: str, record: Watched, saw: int) -> None:
        """Neither process may miss the other's store."""
        run = record.run
        if name == "port_owner" and record.name == EPOCH and run.moving and run.moving[1] < 0:
            run.moving = run.moving[0], saw
        elif name == "supervisor" and self.asks and record.name == MOVING and run.raised and run.raised[1] < 0:
            run.raised = run.raised[0], saw
        else:
            return
        if run.moving and run.raised and min(run.moving[1], run.raised[1]) >= 0:
            (moving, epoch_seen), (raised, moving_seen) = run.moving, run.raised
            if epoch_seen < raised and moving_seen < moving:
                self._witness.wrong(
                    "port owner and supervisor have both missed what the other said of moving and epoch"
                )


def watch_looks(loader: Any, order: Order) -> None:
    """Have supervisor and stopper say when they ask whether anything moves: the supervisor's other looks at that word
    decide how long it sleeps. Have both say what they see of a port owner that is silent."""
    asking = (
        (loader.load("failstop.supervisor.main").Supervisor, "_motion"),
        (loader.load("failstop.procs.stopper.main").Stopper, "_spares"),
    )
    for kind, name in asking:
        setattr(kind, name, _asking(order, getattr(kind, name)))
    starved = loader.load("failstop.procs.starved")
    look = starved.look

    def looks(pid: int, *about: Any) -> bool:
        found: bool = look(pid, *about)
        port_owner = order.machine.processes.get(pid)
        order.looked(starved=found and port_owner is not None and port_owner.name == "port_owner")
        return found

    starved.look = looks


def _asking(order: Order, asks: Any) -> Any:
    def asked(self: Any, *about: Any) -> bool:
        order.asks = True
        try:
            found: bool = asks(self, *about)
        finally:
            order.asks = False
        return found

    return asked


def watch_rings(loader: Any, witness: Witness) -> None:
    """No entry of a ring that was written whole is passed over by a reader who was not a lap behind."""
    reader = loader.load("failstop.shm.cell").RingReader
    passes = reader._pass_damage

    def passed(ring: Any) -> bool:
        lost, awaited = ring.lost, ring._next
        found: bool = passes(ring)
        if ring.lost > lost and max(ring._whole(), default=0) - awaited < ring._cells - 1:
            witness.wrong("an entry of a ring is passed over")
        return found

    reader._pass_damage = passed
