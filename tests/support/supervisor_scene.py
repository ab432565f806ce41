"""The supervisor, turn by turn inside the test, on a simulated machine: the test lets time pass, and is all of its
processes and the board."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import msgpack

from failstop.messages import layout, records
from failstop.messages.packing import pack
from failstop.policy import causes
from failstop.policy.causes import unpack_reply
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.shm.heartbeat import BEAT_RUNNING
from failstop.supervisor import main
from failstop_lab.machine.files import Null, Open
from failstop_lab.machine.kernel import TAKEDOWN_NS
from failstop_lab.machine.loading import Patches
from failstop_lab.machine.process import Process
from failstop_lab.machine.stand_ins import EVERY_RIGHT
from tests.support.stage import MOST_LATE, MS, PortMachine, Wire
from tests.support.why import said, told, why

DEVICE = "/dev/ttyACM0"
RUNTIME_DIR = "/run/failstop/stage"
NOT_STARVED: dict[str, object] = {"starved": None, "starved_times": 0}
"""The fields of an event on a machine that runs everybody."""


def others(name: str) -> tuple[str, ...]:
    return tuple(other for other in PROCESS_BY_NAME if other != name)


class Scene(PortMachine):
    """A supervisor whose processes are programs that only wait; the test beats and writes for them. `own` are their
    segments, `born` all that it has started."""

    def __init__(
        self,
        *running: str,
        granted: int = 0,
        settings: dict[str, object] | None = None,
        journal: Any = None,
        patches: Patches = (),
    ) -> None:
        """`running`: whom it has started already; `granted`: its rights, as bits of the heartbeat."""
        super().__init__(layout.SUPERVISOR, {"HOME": "/root"}, patches)
        self.machine.refused = EVERY_RIGHT & ~granted
        for path in ("/dev/shm", "/sys/dev/char", "/root", RUNTIME_DIR):
            self.machine.root.folder(path)
        self.write("/proc/self/ns/pid", "")
        self.stderr = Null()
        for _ in range(3):
            self.me.descriptor(Open(self.stderr), 0)
        self.born: list[Process] = []
        self.machine.on_event = lambda kind, process, _: self.born.append(process) if kind == "started" else None
        self.machine.programs["bootstrap.py"] = self.wait
        self.late = 0
        changed = {"device.path": DEVICE, **(settings or {})}
        self.settings = self.load("failstop.policy.settings").Settings(changed)
        self.run = self.new_run(journal)
        board = self.load("failstop.board.kinds").board_of(*self.settings.board())
        self.port = self.load("failstop.supervisor.port_handover").OwnPort(self.open(self.wire), board)
        notify = self.load("failstop.notify").Notify()
        self.supervisor = self.load("failstop.supervisor.main").Supervisor(self.run, self.port, notify)
        self.run.publish()
        attach = self.load("failstop.messages.segments").attach
        self.view = attach(self.run.memory, layout.SUPERVISOR)
        self.word = self.view.word
        self._told, self._box = self.view.ring_reader("events"), self.view.ring_reader("box")
        self.own = {name: attach(self.run.memory, name, write=True) for name in layout.PROCESS_NAMES}
        self.port_owner, self.gate, self.telemetry, self.stopper = (
            self.own[name] for name in (layout.PORT_OWNER, layout.GATE, layout.TELEMETRY, layout.STOPPER)
        )
        for name in running:
            self.employ(name)
        self.has_port(layout.PORT_OWNER)
        self.has_port(layout.TELEMETRY)
        self.answers(written_ns=self.now_ns - 10_000 * MS)

    def wait(self, process: Process, argv: list[str]) -> int:
        self.machine.block()
        return 0

    def new_run(self, journal: Any = None) -> Any:
        """All of a run but its name, made as the supervisor makes it."""
        return self.load("failstop.supervisor.run").Run(self.settings, "stage", RUNTIME_DIR, journal)

    def plug(self) -> None:
        self.wire = Wire(self.machine)

    def write(self, path: str, text: str) -> None:
        self.os.makedirs(os.path.dirname(path))
        fd = self.os.open(path, os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        self.os.write(fd, text.encode())
        self.os.close(fd)

    # Time.

    @property
    def now_ns(self) -> int:
        return self.clock()

    @now_ns.setter
    def now_ns(self, t_ns: int) -> None:
        self.clock.now_ns = t_ns

    def pass_time(self, elapsed_ns: int = 0) -> bytes:
        """Time passes, nobody beats, and the supervisor wakes up; returns what it wrote to a port that drains."""
        self.now_ns += elapsed_ns
        self.supervisor.turn(self.supervisor.loop.wait(0))
        self.late = self.late + 1 if self.next_ns() <= self.now_ns else 0
        assert self.late <= MOST_LATE, "a timer was left behind: the loop would spin"
        return self.wire.read() if self.wire.port.drains else b""

    def turn(self, elapsed_ns: int = 0) -> bytes:
        self.now_ns += elapsed_ns
        self.beat(layout.PORT_OWNER)
        return self.pass_time()

    def tick(self, elapsed_ns: int, *, beating: tuple[str, ...] = ()) -> bytes:
        """Time passes with a turn at each tick, in which these beat; returns what it wrote."""
        wrote = b""
        while elapsed_ns > 0:
            step_ns = min(elapsed_ns, main.TICK_NS)
            self.now_ns += step_ns
            elapsed_ns -= step_ns
            self.beat(*beating)
            wrote += self.pass_time()
        return wrote

    def next_ns(self) -> int:
        due_ns: int = self.supervisor.loop.due_ns()
        return min(self.now_ns + main.TICK_NS, due_ns)

    # Its processes.

    def employ(self, name: str) -> Process:
        """A process that says that it runs; started, unless it is."""
        child = self.supervisor.processes[name]
        if not child.pid:
            self.supervisor.processes.start(child)
        for word, value in (("beat_pid", child.pid), ("beat_state", BEAT_RUNNING)):
            self.own[name].word(word).set(value)
        self.beat(name)
        self.supervisor.processes.watch_early()
        return self.machine.processes[child.pid]

    def dies(self, who: str | Process, code: int = -9) -> None:
        """A process dies, and the late news of it has come; by its name one that runs."""
        self.machine.die(self.employ(who) if isinstance(who, str) else who, code)
        self.now_ns += TAKEDOWN_NS

    def starve(self, name: str) -> None:
        self.machine.hold(self.employ(name), 1 << 61, starved=True)

    def running(self, program: str) -> list[Process]:
        return [process for process in self.born if process.name == program and not process.dead]

    def state(self, name: str) -> str:
        state: str = self.supervisor.processes[name].state
        return state

    def beat(self, *names: str) -> None:
        for name in names:
            self.own[name].word("beat_ns").set(self.now_ns)

    def keep_beating(self) -> None:
        self.beat(*layout.PROCESS_NAMES[1:])
        self.machine.at(self.now_ns + MS, self.keep_beating)

    def has_port(self, name: str, number: int = 1, state: int = records.PORT_OPEN) -> None:
        """A process says of a port that it has it, or `state`."""
        if name != layout.PORT_OWNER:
            self.own[name].word("port_number").set(number)
        else:
            packed = records.PORT.pack(number, self.now_ns, state, DEVICE)
            self.port_owner.latest_writer("port").write(packed)

    def answers(self, *, written_ns: int = 0) -> None:
        """The port owner answers the epoch; `written_ns`: with a burst written then."""
        if written_ns:
            self.port_owner.word("written_ns").set(written_ns)
        self.port_owner.word("stopped_epoch").set(self.supervisor.epochs.number)

    def enabled(self, epoch: int = 1, **more: object) -> None:
        self.gate.latest_writer("state").write(pack({"enabled": True, "epoch": epoch, **more}))

    def notice(self, reason: str = "key1", *, written_ns: int = 0, late_ns: int = 0) -> None:
        self.raises(layout.PORT_OWNER, why(reason), written_ns=written_ns, late_ns=late_ns)

    def gate_stops(self, reason: str = "multiple cmd_vel publishers") -> None:
        self.raises(layout.GATE, why(reason))

    def raises(self, name: str, cause: causes.Cause, *, written_ns: int = 0, late_ns: int = 0) -> None:
        """A process publishes a cause, as of a while later than now."""
        stop = records.STOPPED.pack(1, self.now_ns + late_ns, written_ns, cause.pack())
        self.own[name].ring_writer("stops").put(stop)

    def pings(self, *, answered: bool = True) -> None:
        """A ping goes out now; its answer comes a millisecond later."""
        self.port_owner.word("asked_ns").set(self.now_ns)
        if answered:
            self.answered(self.now_ns, self.now_ns + MS)

    def answered(self, asked_ns: int, came_ns: int) -> None:
        """Telemetry has heard the answer to what was asked then, which proves that the board has handled it."""
        for record in ("answered", "proved"):
            self.telemetry.latest_writer(record).write(records.PROVED.pack(asked_ns, came_ns))

    def judge(self, *, still: bool) -> None:
        self.telemetry.word("still_ns").set(self.now_ns if still else 0)
        self.telemetry.word("judged_ns").set(self.now_ns)

    def ask_reset(self, asked_ns: int | None = None) -> None:
        self.gate.word("reset_asked_ns").set(asked_ns or self.now_ns)
        self.gate.word("resets_asked").set(self.gate.word("resets_asked").get() + 1)

    def made_stop(self, cause: causes.Cause, by: str, t_ns: int = 0) -> Any:
        """A Stop of the supervisor's own modules, noticed at that time, or now."""
        found = self.load("failstop.policy.causes").read(cause.pack())
        return self.load("failstop.supervisor.stops").Stop(t_ns or self.now_ns, by, found)

    def stops(self, reason: str) -> None:
        self.gate_stops(reason)
        self.turn()
        self.answers(written_ns=self.now_ns)
        self.turn(MS)

    def reset(self) -> None:
        self.ask_reset()
        self.turn(MS)
        assert self.decided() is not None

    # Its words to others.

    def read(self, record: str) -> bytes:
        entry = self.view.latest_reader(record).read()
        assert entry is not None
        found: bytes = entry[2]
        return found

    def number(self, record: str) -> int:
        """The number of a record, which grows as it is written; 0: it was not."""
        entry = self.view.latest_reader(record).read()
        return entry[0] if entry else 0

    def table(self, record: str) -> dict[str, Any]:
        found: dict[str, Any] = msgpack.unpackb(self.read(record))
        return found

    def waits_for(self) -> str:
        """The processes or the port that motion waits for, as everybody reads."""
        found: str = self.table("processes")["waiting_for"] or ""
        return found

    def told(self) -> dict[str, Any]:
        """The last stop: why, who wrote it, and when."""
        found = self.table("stop")
        times = {key: found[key] for key in ("written_by", "written_us")}
        return {"reason": said(causes.read(found["cause"])), **times}

    def cause(self) -> tuple[int, str]:
        """The epoch since which a stop is latched (0: none is), and the cause, as everybody reads."""
        since, _, _, cause = records.LATCH.unpack(self.read("latch"))
        return since, said(causes.read(cause))

    def decided(self) -> tuple[bool, str] | None:
        """The answer to the last reset; None: it is not decided."""
        if self.word("resets").get() != self.gate.word("resets_asked").get():
            return None
        return told(unpack_reply(self.read("reset"))[2])

    def boxed(self) -> list[tuple[int, bytes]]:
        """The black box's entries since the last call, with their times."""
        found = []
        while entry := self._box.next():
            found.append((entry[1], entry[2]))
        return found

    def events(self) -> list[dict[str, Any]]:
        found = []
        while entry := self._told.next():
            found.append(msgpack.unpackb(entry[2]))
        return found

    def said(self) -> list[tuple[str, str, str, dict[str, Any]]]:
        """Events that people are told of at once: kind, level, text and fields of each."""
        self.run.events.flush()
        return [(event["kind"], event["level"], event["text"], event["fields"]) for event in self.events()]

    def starved(self) -> list[tuple[str, int, int]]:
        """The silences since the last call that were said to be the machine's."""
        found = [event["fields"] for event in self.events() if event["kind"] == "starved"]
        return [(fields["process"], fields["silent_ms"], fields["times"]) for fields in found]

    def rung(self, process: str) -> bool:
        bell = self.run.bells[process]
        found: bool = self.supervisor.loop.readable(bell.fd)
        bell.clear()
        return found

    def fds(self) -> set[int]:
        return set(self.me.files)

    def refuse(self, call: str, error: Exception, when: Callable[..., bool] = lambda *about: True) -> None:
        """Have that call of the system fail from now on, of the supervisor."""

        def at_seam(thread: Any, name: str, about: tuple[Any, ...]) -> None:
            if name == call and thread is self.machine.inline and when(*about):
                raise error

        self.machine.at_seam = at_seam

    def allow(self) -> None:
        """No call fails any more."""
        self.machine.at_seam = None
