"""A stage for one process of the service, run turn by turn inside the test, on a simulated machine: its segments,
bells, pipes, sockets and port are the machine's, its clock stands still but for what the test lets pass, and the test
is in the roles of all other processes."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, ClassVar

from failstop.messages import layout, records
from failstop.shm import heartbeat
from failstop_lab.machine.files import IN, OUT, Open, Pidfd
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import File, Loader, Patches
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Thread

MS = 1_000_000
MOST_LATE = 3
"""Turns in a row that are due at once: one for each thing that is overdue."""
INCARNATION = 0xFA11_5709
BELLS = ("bell", "supervisor_bell", "telemetry_bell", "port_owner_bell", "gate_bell")
RUNTIME_DIR = "/run/failstop/stage"


class BoardPort(Port):
    """A port whose driver has little room, or counts bytes that are under way."""

    room: int | None = None
    """The number of bytes that it still takes; None: as many as a port does."""
    under_way = 0
    """Bytes that the kernel says it holds, beside those that it does."""

    def takes(self, room: int | None = None) -> None:
        """Take so many bytes from here on; None: all."""
        self.room = room
        self.notify()

    def mask(self, opened: Open) -> int:
        return super().mask(opened) & ~(OUT if self.room == 0 else 0)

    def unsent(self) -> int:
        return super().unsent() + self.under_way

    def write(self, opened: Open, data: bytes) -> int:
        taken = super().write(opened, data if self.room is None else data[: self.room])
        self.room = None if self.room is None else self.room - taken
        return taken


class Wire:
    """The board's side of a port: keeps what has reached it."""

    def __init__(self, machine: Machine, number: int = 0) -> None:
        self.machine, self.number = machine, number
        self.link = f"/dev/ttyACM{number}"
        self.port = BoardPort(machine, number)
        self.port.board = self
        self._folder = machine.root.folder("/dev")
        self._came = bytearray()
        self.on_bytes: Callable[[bytes], None] = lambda data: None
        """Called when bytes reach the board's side."""
        self._folder.put(f"ttyACM{number}", self.port)

    def receive(self, data: bytes) -> None:
        self._came += data
        self.on_bytes(data)

    def read(self) -> bytes:
        """Everything that has reached the board's side since the last call; makes room in a port that was full."""
        self.port.drain()
        found = bytes(self._came)
        self._came.clear()
        return found

    def fill(self) -> None:
        self.port.drains = False
        self.port.held += bytes(self.port.ROOM - len(self.port.held))

    def hold(self) -> None:
        """The kernel has bytes for the port, and passes nothing on until it drains."""
        self.port.drains = False
        self.port.held += b"\0"

    def unplug(self) -> None:
        """The board goes: the port is hung up."""
        if not self.port.gone:
            self._folder.drop(f"ttyACM{self.number}")
            self.port.unplug()

    def replug(self) -> Wire:
        self.unplug()
        return Wire(self.machine, self.number + 1)


class Early:
    """No early news of deaths, but for what the test tells: who is killed is told by its pidfd."""

    def __init__(self, bell: Any) -> None:
        self.bell = bell
        self.watched: list[tuple[int, int, int]] = []
        """The process whose death is waited for, and its futex: pid, block, index."""
        self.dying: dict[int, int] = {}
        """The priority that a thread which stops for a process is to run above, by its pid."""
        self._lives: dict[int, tuple[Any, Callable[[], None] | None]] = {}

    def watch_block(
        self, life: Any, block: int, index: int, stop: Callable[[], None] | None = None, dying: int = 0
    ) -> None:
        """Nothing to wait for."""
        life.watched = True
        self.watched.append((life.pid, block, index))
        self.dying[life.pid] = dying
        self._lives[life.pid] = (life, stop)

    def tell(self, pid: int) -> None:
        """The act of the thread that waits for this one's death, when the news comes early."""
        life, stop = self._lives[pid]
        life.marked = True
        if stop:
            stop()
        self.bell.ring()

    def watch(self, life: Any, segment: Any, line: int = 0) -> None:
        """Nothing to watch here."""


class Dummy:
    """A process that waits to be killed; a dead one stays a zombie, as an unburied child does."""

    def __init__(self, machine: Machine, name: str) -> None:
        self._machine = machine
        parent = machine.inline.process if machine.inline else None
        self._process = machine.process(name, lambda process: machine.block(), parent=parent)
        self.pid = self._process.pid

    def kill(self) -> None:
        self._machine.die(self._process, -9)
        self._machine.run(lambda: self._process.code is not None, 1_000 * MS)

    def starve(self) -> None:
        self._machine.hold(self._process, 1 << 61, starved=True)

    def lives(self) -> bool:
        return not self._process.dead


class Clock:
    """CLOCK_MONOTONIC of a machine, which a test moves by setting `now_ns`."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def __call__(self) -> int:
        return self._machine.now_ns

    @property
    def now_ns(self) -> int:
        return self._machine.now_ns

    @now_ns.setter
    def now_ns(self, t_ns: int) -> None:
        self._machine.run(lambda: False, t_ns - self._machine.now_ns)


class PortMachine:
    """A simulated machine with a board's port. The test is a process of it.

    load() gives failstop's modules as that process has them. Who asks a module that the test itself imports asks the
    real machine."""

    def __init__(self, process: str = "test", environ: dict[str, str] | None = None, patches: Patches = ()) -> None:
        self.machine = Machine(step_ns=0, look_ns=0)
        self.me = self.machine.join(process, environ)
        loader = Loader(self.machine, patches)
        self.load, self.os, self.system = loader.load, loader.system["os"], loader.system
        self.clock = Clock(self.machine)
        self.wire = Wire(self.machine)

    def open(self, wire: Wire) -> int:
        found: int = self.os.open(wire.link, os.O_RDWR | os.O_NONBLOCK)
        return found

    def open_fds(self) -> int:
        return len(self.me.files)

    def after(self, ns: int, action: Callable[[], object]) -> None:
        self.machine.at(self.clock() + ns, lambda: (action(), None)[1])

    def at_next(self, call: str, action: Callable[[], object]) -> None:
        """Have something happen once, just before the process's next call of the system by this name."""

        def seam(thread: Thread, made: str, about: tuple[Any, ...]) -> None:
            if made == call:
                self.machine.at_seam = None
                action()

        self.machine.at_seam = seam


class Stage(PortMachine):
    """Plays supervisor, gate and clients around one process. The context that the process is given is this object."""

    changed: ClassVar[dict[str, object]] = {}
    """Settings that are not the defaults."""

    def __init__(self, process: str, *, open_port: bool = True, **changed: object) -> None:
        super().__init__(process)
        self.process = process
        self.name = self.instance = "stage"
        for path in ("/dev/shm", "/proc", "/tmp", RUNTIME_DIR):
            self.machine.root.folder(path)
        self.runtime_dir = RUNTIME_DIR
        self._bell, self._segment = self.load("failstop.shm.bell"), self.load("failstop.messages.segments")
        for spec in layout.SEGMENTS:
            self._segment.create(self.name, spec.name, INCARNATION).close()
        changed = {"device.path": self.wire.link, **self.changed, **changed}
        self.settings = self.load("failstop.policy.settings").Settings(changed)
        self.board = self.load("failstop.board.kinds").board_of(*self.settings.board())
        self.supervisor = Dummy(self.machine, layout.SUPERVISOR)
        self.parent = self.supervisor.pid
        self.early = Early(self._bell.EventBell.create())
        self.own = self.owned(process)
        self.heartbeat = self.load("failstop.shm.heartbeat").Heartbeat(self.own, self.me.pid, 0, self.clock())
        self._bell.make_pipe(f"{RUNTIME_DIR}/stop", 0o600)
        handover = self.load("failstop.procs.handover")
        mine, theirs = handover.pair()
        self.control = handover.Control(mine)
        self._fds = {
            "stop": self._bell.open_pipe(f"{RUNTIME_DIR}/stop"),
            "control": theirs,
            "port": self.open(self.wire) if open_port else -1,
        }
        self.port_number = 1
        self._bells = {name: self._bell.EventBell.create() for name in BELLS}
        self.views = {name: self.owned(name) for name in layout.PROCESS_NAMES}
        self.frames = self.views[layout.GATE].ring_writer("frames")
        self.raise_epoch(1)
        self.beat(layout.SUPERVISOR, layout.GATE)

    # What Context offers.

    def client_slots(self) -> list[Any]:
        return [self._segment.read_client_slot(self.name, index, INCARNATION) for index in range(layout.CLIENT_SLOTS)]

    def fd(self, key: str) -> int:
        return self._fds[key]

    def bell(self, key: str) -> Any:
        return self._bells[key]

    def segment(self, name: str) -> Any:
        return self._segment.attach(self.name, name, INCARNATION)

    # The rest of the service.

    def owned(self, name: str) -> Any:
        return self._segment.attach(self.name, name, INCARNATION, write=True)

    def news_of(self, dummy: Dummy) -> dict[int, int]:
        """The result of a wait to which the news of its death has come, and no other."""
        files = {fd: opened.node for fd, opened in self.me.files.items()}
        return {fd: IN for fd, node in files.items() if isinstance(node, Pidfd) and node.process.pid == dummy.pid}

    def raise_epoch(self, epoch: int) -> None:
        self.views[layout.SUPERVISOR].word("epoch").set(epoch)

    def beat(self, *processes: str, age_ns: int = 0) -> None:
        for process in processes:
            self.views[process].word("beat_ns").set(self.clock() - age_ns)

    def start(self, process: str, state: int = heartbeat.BEAT_RUNNING) -> Dummy:
        dummy = Dummy(self.machine, process)
        self.views[process].word("beat_pid").set(dummy.pid)
        self.views[process].word("beat_state").set(state)
        self.views[layout.SUPERVISOR].word(f"{process}_life").set(records.life(dummy.pid, 3))
        self.beat(process)
        return dummy

    def runs(self, process: str) -> None:
        self.views[process].word("beat_state").set(heartbeat.BEAT_RUNNING)

    def ask_to_stop(self, message: bytes) -> None:
        self.os.write(self._fds["stop"], message)

    def send_port(self, wire: Wire, number: int) -> None:
        fd = self.open(wire)
        self.control.send(fd, number, wire.link)
        self.os.close(fd)

    def replug(self, number: int) -> Wire:
        """The board comes back, and the supervisor has opened the port."""
        self.wire = self.wire.replug()
        self.send_port(self.wire, number)
        return self.wire

    def write_text(self, path: str, text: str) -> None:
        with File(self.os, path, "w", None) as file:
            file.write(text)

    def read_text(self, path: str) -> str:
        with File(self.os, path, "r", None) as file:
            return str(file.read())
