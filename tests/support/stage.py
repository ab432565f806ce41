"""A stage for one process of the service, run turn by turn inside the test: real segments, bells, pipes, sockets and a
pty, a clock that the test moves, and the test in the roles of all other processes."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from failstop.policy.settings import Settings
from failstop.procs import handover
from failstop.procs.handover import Control
from failstop.shm import bell, heartbeat, layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import Heartbeat
from failstop.shm.lifeline import Lifeline
from failstop.shm.segment import Segment
from tests.support.played import PlayedWorld
from tests.support.ptys import Pty
from tests.support.waiting import until

MS = 1_000_000
MOST_LATE = 3
"""Turns in a row that are due at once: one for each thing that is overdue."""
INCARNATION = 0xFA11_5709
BELLS = ("bell", "supervisor_bell", "telemetry_bell", "port_owner_bell")
_numbers = itertools.count()


class Early:
    """No early news of deaths: what a test kills is told by its pidfd."""

    def __init__(self) -> None:
        self.bell = EventBell.create()
        self.armed: list[tuple[int, int, int]] = []
        """Whose death is waited for, at which futex: pid, block, index."""
        self.dying: dict[int, int] = {}
        """By its pid: the priority that a thread which stops for it is to run above."""
        self._lives: dict[int, tuple[Lifeline, Callable[[], None] | None]] = {}

    def arm(
        self, life: Lifeline, block: int, index: int, stop: Callable[[], None] | None = None, dying: int = 0
    ) -> None:
        """Nothing to wait for."""
        life.armed = True
        self.armed.append((life.pid, block, index))
        self.dying[life.pid] = dying
        self._lives[life.pid] = (life, stop)

    def tell(self, pid: int) -> None:
        """What the thread does that waits for this one's death, when the news comes early."""
        life, stop = self._lives[pid]
        life.marked = True
        if stop:
            stop()
        self.bell.ring()

    def watch(self, life: Lifeline, segment: Segment, line: int = 0) -> None:
        """Nor here."""


class Clock:
    """CLOCK_MONOTONIC as the process sees it."""

    def __init__(self) -> None:
        self.now_ns = 50_000 * MS

    def __call__(self) -> int:
        return self.now_ns


class Dummy:
    """A process that waits to be killed."""

    def __init__(self) -> None:
        # Not a fork: it would keep the pty's other side open, and with it put off a hang-up.
        self.pid = os.posix_spawnp("sleep", ["sleep", "120"], os.environ)
        # One that still starts is runnable, and its silence the machine's.
        until(self._sleeps, "its sleep")
        self._alive = True

    def _sleeps(self) -> bool:
        with open(f"/proc/{self.pid}/stat", encoding="utf-8") as file:
            return file.read().split()[1:3] == ["(sleep)", "S"]

    def kill(self) -> None:
        """SIGKILL, and wait until it is gone; it stays a zombie, as an unburied child does."""
        if self._alive:
            self._alive = False
            os.kill(self.pid, signal.SIGKILL)
            os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)

    def lives(self) -> bool:
        """Nobody has killed it."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None

    def close(self) -> None:
        """Kill and reap."""
        self.kill()
        os.waitpid(self.pid, 0)


class Stage:
    """Plays supervisor, gate and clients around one process. The context that the process is given is this object."""

    changed: ClassVar[dict[str, object]] = {}
    """Settings that are not the defaults."""

    def __init__(self, process: str, directory: Path, *, open_port: bool = True) -> None:
        self.process = process
        self.name = f"s{os.getpid()}x{next(_numbers)}"
        for spec in layout.SEGMENTS:
            segment.create(self.name, spec.name, INCARNATION).close()
        self.clock = Clock()
        self.world = PlayedWorld(now_ns=self.clock)
        self.pty = Pty()
        self.settings = Settings({"device.path": self.pty.link, **self.changed})
        self.supervisor = Dummy()
        self.parent = self.supervisor.pid
        self.others: list[Dummy] = []
        self.early = Early()
        self.own = self.owned(process)
        self.heartbeat = Heartbeat(self.own, os.getpid(), 0, self.clock())
        bell.make_pipe(str(directory / "stop"), 0o600)
        mine, theirs = handover.pair()
        self.control = Control(mine)
        self._port = os.dup(self.pty.slave) if open_port else -1
        self._fds = {"stop": bell.open_pipe(str(directory / "stop")), "control": theirs, "port": self._port}
        self.port_number = 1
        self._bells = {name: EventBell.create() for name in BELLS}
        self._views = {name: self.owned(name) for name in layout.PROCESSES}
        self.frames = self._views[layout.GATE].ring_writer("frames")
        self._slots: list[Segment] = []
        self.raise_epoch(1)
        self.beat(layout.SUPERVISOR, layout.GATE)

    # What Context offers.

    def client_slots(self) -> list[Segment]:
        """Every client's slot, to read."""
        found = [segment.read_client_slot(self.name, index, INCARNATION) for index in range(layout.CLIENT_SLOTS)]
        self._slots += found
        return found

    def fd(self, key: str) -> int:
        return self._fds[key]

    def bell(self, key: str) -> EventBell:
        return self._bells[key]

    def segment(self, name: str) -> Segment:
        return segment.attach(self.name, name, INCARNATION)

    # The rest of the service.

    def owned(self, name: str) -> Segment:
        """A segment as its own process has it."""
        return segment.attach(self.name, name, INCARNATION, write=True)

    def raise_epoch(self, epoch: int) -> None:
        self._views[layout.SUPERVISOR].word("epoch").set(epoch)

    def beat(self, *processes: str, age_ns: int = 0) -> None:
        for process in processes:
            self._views[process].word("beat_ns").set(self.clock() - age_ns)

    def start(self, process: str, state: int = heartbeat.RUNNING) -> Dummy:
        """A new process which the supervisor names."""
        dummy = Dummy()
        self.others.append(dummy)
        self._views[process].word("beat_pid").set(dummy.pid)
        self._views[process].word("beat_state").set(state)
        self._views[layout.SUPERVISOR].word(f"{process}_life").set(records.life(dummy.pid, 3))
        self.beat(process)
        return dummy

    def runs(self, process: str) -> None:
        """It says so."""
        self._views[process].word("beat_state").set(heartbeat.RUNNING)

    def ask_to_stop(self, message: bytes) -> None:
        os.write(self._fds["stop"], message)

    def replug(self, number: int) -> Pty:
        """The board comes back, and the supervisor has opened the port."""
        self.pty.close()
        self.pty = Pty()
        self.control.send(self.pty.slave, number, self.pty.link)
        return self.pty

    def close(self) -> None:
        """Take everything away."""
        for dummy in (self.supervisor, *self.others):
            dummy.close()
        self.control.close()
        self.pty.close()
        for slot in self._slots:
            slot.close()
        for fd in (self._fds["stop"], self.early.bell.fd, *(found.fd for found in self._bells.values())):
            os.close(fd)
        segment.unlink_all(self.name)
