"""Robot: the service, its board and the programs that drive it, on a simulated machine."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import msgpack

from failstop.policy.layouts import BOARDS
from failstop_lab.boards.live import LiveModel, board_model
from failstop_lab.boards.traits import traits_of
from failstop_lab.machine.epoll import Epoll
from failstop_lab.machine.files import Node, Null, Open, Regular
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader, Patches
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Process, Replaced
from failstop_lab.machine.usb import LookAlike, Plug, Usb
from failstop_lab.sim.model import Frame

DEVICE, SETTINGS = "/dev/ttyACM0", "/etc/failstop.toml"
RUN = ("--config", SETTINGS, "--device", DEVICE, "--name", "failstop")
NODES = tuple(f"ttyACM{number}" for number in range(4))
MS = 1_000_000
CLICKED = 0x20
COMMAND_EVERY_S = 0.02
ENVIRON = {"HOME": "/root"}


class BoardPort:
    """The board's model behind a port of the machine."""

    def __init__(self, machine: Machine, imu_hz: float, kind: str, motors: int = 0) -> None:
        self.machine = machine
        self.traits = traits_of(kind)
        self.model = board_model(kind, machine.now_ns, imu_hz=imu_hz, motors=motors)
        self.port: Port | None = None
        self.on_frame: Callable[[Frame], None] = lambda frame: None
        self.on_bytes: Callable[[bytes], None] = lambda data: None
        self.on_taken: Callable[[bytes], None] = lambda data: None
        """Called with what the kernel takes of each write to the port, when it takes it."""
        self.down_ns = self.up_ns = 0
        """How long bytes are on their way to the board, and back: as behind a slow bridge. They overtake none."""
        self._down_last_ns = self._up_last_ns = 0
        self.written_ns: dict[int, int] = {}
        """When the bytes were written that came to the board at a certain time; of those that took any."""
        self._told = 0
        self._due_ns = 1 << 62
        self.plan()

    def receive(self, data: bytes) -> None:
        """Bytes of the port, which come to the board now or later."""
        self.catch_up()
        self.on_bytes(data)
        now_ns = self.machine.now_ns
        if not self.down_ns and self._down_last_ns <= now_ns:
            self.model.receive(data, now_ns)
            self.plan()
            return
        self._down_last_ns = max(now_ns + self.down_ns, self._down_last_ns + 1)
        self.written_ns[self._down_last_ns] = now_ns
        self.machine.at(self._down_last_ns, lambda: self._arrive(data))

    def _arrive(self, data: bytes) -> None:
        self.catch_up()
        self.model.receive(data, self.machine.now_ns)
        self.plan()

    def press(self, key: int) -> None:
        """A key is clicked."""
        self.model.key(key, CLICKED, self.machine.now_ns)
        self.plan()

    def opened(self) -> None:
        """Reset it, where opening its port does: a kernel that has opened the port before leaves the line as it is."""
        if self.traits.resets and isinstance(self.model, LiveModel):
            self.catch_up()
            self.model.restart(self.machine.now_ns, self.traits.deaf_ns)

    def restart(self, deaf_ns: int) -> None:
        """A dip of its supply: it starts again, and hears and reports nothing for so long."""
        self.catch_up()
        self.model.restart(self.machine.now_ns, deaf_ns)
        self._told = self.model.executed_total
        self.plan()

    def lie(self, times: float, more_rps: float = 0.0) -> None:
        """Its reports say that every wheel turns so many times as fast as it does, and by `more_rps` more."""
        self.catch_up()
        self.model.lie(times, more_rps)

    def behave(self) -> None:
        """What it reports is true, and arrives at once; it hears, and its wheels do what they are told."""
        self.lie(1.0)
        self.up_ns, self.model.silent, self.model.deaf = 0, False, False
        if isinstance(self.model, LiveModel):
            self.model.roll(1.0, 0.0)

    def plan(self) -> None:
        """Have the time pass when something is due: call it after a change of the model."""
        due_ns = self.model.next_ns
        if due_ns < self._due_ns:
            self._due_ns = due_ns
            self.machine.at(due_ns, lambda: self._pass_time(due_ns))

    def _pass_time(self, due_ns: int) -> None:
        if due_ns != self._due_ns:
            return  # something was due before this
        self._due_ns = 1 << 62
        self.catch_up()
        self.plan()

    def catch_up(self) -> None:
        """Let everything happen that is due by now: a model of another board passes its time in steps."""
        for data in self.model.advance(self.machine.now_ns):
            if self.port:
                self._send(self.port, data)
        total = self.model.executed_total
        if total > self._told:
            for frame in self.model.executed(self._told):
                self.on_frame(frame)
            self._told = total

    def _send(self, port: Port, data: bytes) -> None:
        now_ns = self.machine.now_ns
        if not self.up_ns and self._up_last_ns <= now_ns:
            port.send(data)
            return
        self._up_last_ns = max(now_ns + self.up_ns, self._up_last_ns + 1)
        self.machine.at(self._up_last_ns, lambda: port.send(data))


class Robot:
    """A machine with one board of any kind on DEVICE. start() starts the service, program() a client."""

    def __init__(
        self,
        seed: int = 0,
        *,
        imu_hz: float = 110.0,
        settings: dict[str, object] | None = None,
        patches: Patches = (),
        kind: str = BOARDS[0],
        weak: bool = False,
        usb: Plug | None = None,
        motors: int = 0,
    ) -> None:
        """`kind`: as the setting board.kind. `weak`: its memory may be seen in other orders. `usb`: the board's device
        on USB; without one its port is none of USB's. `motors`: how many the board has, where boards of its kind
        differ; 0: as usual. Raises ValueError."""
        Node.count = 0
        self.machine = WeakMachine(seed) if weak else Machine(seed)
        self.loader = Loader(self.machine, patches)
        if isinstance(self.machine, WeakMachine):
            self.machine.weaken(self.loader)
        self.time: Any = self.loader.system["time"]
        self.board = BoardPort(self.machine, imu_hz, kind, motors)
        self.stderr = Null()
        self._numbers = 0
        self._usb = Usb(self.machine)
        self._plugged: dict[str, tuple[Port, Plug]] = {}
        self._make_files({**self.board.traits.settings, **(settings or {})})
        if usb:
            self.plug_usb(NODES[0], usb)
        else:
            self.plug()
        self.machine.programs |= {"bootstrap.py": self._child, "saver.py": self._save}

    def _make_files(self, settings: Mapping[str, object]) -> None:
        for path in ("/dev/shm", "/run", "/var/lib/failstop", "/root", "/sys/dev/char", "/proc"):
            self.machine.root.folder(path)
        self.machine.root.folder("/dev").put("null", Null())
        self.write(SETTINGS, "".join(f"{key} = {json.dumps(value)}\n" for key, value in settings.items()))

    def plug(self) -> Port:
        """Plug the board in, under its own name."""
        port = Port(self.machine, self._numbers)
        self._numbers += 1
        self._connect(port)
        self.machine.root.folder("/dev").put("ttyACM0", port)
        return port

    def _connect(self, port: Port) -> None:
        """Put the board behind this port."""
        port.board, self.board.port = self.board, port
        port.on_first_open = self.board.opened
        port.on_taken = lambda data: self.board.on_taken(data)

    def plug_usb(self, name: str, plug: Plug, look_alike: LookAlike | None = None) -> Port:
        """Plug the board in as a device on USB, with that name of a tty; or a look-alike."""
        port = Port(self.machine, NODES.index(name))
        if look_alike:
            port.board, look_alike.port = look_alike, port
        else:
            self._connect(port)
        self._usb.add(name, port, plug)
        self._plugged[name] = port, plug
        self.machine.root.folder("/dev").put(name, port)
        return port

    def unplug_usb(self) -> None:
        """Everything that was plugged in so is gone, as when a hub is reset."""
        for name, (port, plug) in self._plugged.items():
            self.machine.root.folder("/dev").drop(name)
            self._usb.remove(name, port, plug)
            port.unplug()
            port.board.port = None
        self._plugged.clear()

    def unplug(self, late_ns: Callable[[Epoll], int] = lambda epoll: 0) -> None:
        """Pull the plug; `late_ns` as in Port.unplug."""
        if self.board.port:
            self.machine.root.folder("/dev").drop("ttyACM0")
            self.board.port.unplug(late_ns)
            self.board.port = None

    def streams(self, process: Process) -> None:
        """Give a process its standard streams."""
        for _ in range(3):
            process.descriptor(Open(self.stderr), 0)

    @property
    def said(self) -> str:
        """The text that its processes have written to their standard streams."""
        return b"".join(self.stderr.heard).decode("utf-8", "replace")

    def write(self, path: str, text: str) -> None:
        """A file of people's, instead of one that was there."""
        above, _, name = path.rpartition("/")
        file = Regular(0o644)
        file.put(text.encode(), 0)
        folder = self.machine.root.folder(above)
        if name in folder.names:
            folder.drop(name)
        folder.put(name, file)

    def read(self, path: str) -> str:
        """The text of a file."""
        above, _, name = path.rpartition("/")
        file = self.machine.root.folder(above).names[name]
        assert isinstance(file, Regular)
        return file.get(0, file.size()).decode()

    def _child(self, process: Process, argv: list[str]) -> int:
        process.argv = argv
        code: int = self.loader.load("failstop.supervisor.bootstrap").main(argv)
        return code

    def _save(self, process: Process, argv: list[str]) -> int:
        """The saver of incidents, which has nothing to tell here."""
        words = dict(word.split("=", 1) for word in argv[1:])
        with contextlib.suppress(BrokenPipeError):
            self.loader.system["os"].write(int(words["result"]), msgpack.packb({}))
        return 0

    def start(self) -> Process:
        """Start the service by `failstop run`, which stops first and then becomes the supervisor."""

        def body(process: Process) -> int:
            self.streams(process)
            command = self.loader.load("failstop.cli.main")
            try:
                code: int = command._main(["run", *RUN])
            except Replaced as program:
                return self._child(process, program.argv[program.argv.index("supervisor") - 1 :])
            except Exception as error:  # as main() does, which would keep an interrupt of the campaign's own
                code = command._report_error(error)
            return code

        return self.machine.process("supervisor", body, dict(ENVIRON))

    def program(self, name: str, body: Callable[[Any], object]) -> Process:
        """Start a client's program: `body` is called with the module `failstop` of that machine."""

        def run(process: Process) -> int:
            self.streams(process)
            process.argv = [name]
            body(self.loader.load("failstop"))
            return 0

        return self.machine.process(name, run, dict(ENVIRON))

    def join(self, name: str) -> Process:
        """A program that is the caller's own: its calls are made inline (Machine.join)."""
        me = self.machine.join(name, dict(ENVIRON))
        self.streams(me)
        return me

    def command(
        self,
        words: Sequence[str],
        each: Callable[[], object] = lambda: None,
        environ: Mapping[str, str] = MappingProxyType({}),
    ) -> tuple[int, str, str]:
        """Run `failstop ...` beside the inline program, which calls `each` every 20 ms meanwhile; the exit code, what
        it printed, its errors."""
        out, err = Null(), Null()

        def run(process: Process) -> object:
            for node in (Null(), out, err):
                process.descriptor(Open(node), 0)
            process.argv = ["failstop", *words]
            return self.loader.load("failstop.cli.main").main(list(words))

        process = self.machine.process(words[0], run, {**ENVIRON, **environ})
        while process.code is None:
            each()
            self.time.sleep(COMMAND_EVERY_S)
        printed, errors = (b"".join(node.heard).decode() for node in (out, err))
        return process.code, printed, errors

    def connect(self, **options: Any) -> Any:
        """A client of the run that is there, once nothing of it is waited for."""
        failstop = self.loader.load("failstop")
        while True:
            with contextlib.suppress(failstop.NoService):
                client = failstop.Robot(**options)
                while client.state.waiting_for is not None:
                    self.time.sleep(0.002)
                return client
            self.time.sleep(0.002)

    def drive(
        self,
        client: Any,
        seconds: float,
        velocity: tuple[float, float, float],
        each: Callable[[], object] = lambda: None,
        *,
        sensed: bool = True,
    ) -> None:
        """Command a velocity for so long, with news of the sensor unless it is silent, and what `each` does."""
        until_s = self.time.monotonic() + seconds
        while self.time.monotonic() < until_s:
            if sensed:
                client.sensed()
            client.drive(*velocity)
            each()
            self.time.sleep(COMMAND_EVERY_S)

    def kill(self, name: str) -> Process | None:
        """SIGKILL a process of the service."""
        if found := self.named(name):
            self.machine.die(found, -9)
        return found

    def named(self, name: str) -> Process | None:
        """The living process of that name."""
        living = [each for each in self.machine.processes.values() if each.name == name and not each.dead]
        return living[-1] if living else None
