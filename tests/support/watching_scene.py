"""The supervisor with processes to watch, which are the test."""

from __future__ import annotations

import contextlib
import os
import select
from pathlib import Path

import pytest

from failstop.policy.processes import BY_NAME
from failstop.procs.loop import NEVER, READ
from failstop.shm import layout, records, segment
from failstop.shm.heartbeat import RUNNING
from failstop.shm.packing import pack
from failstop.supervisor import process_table as table_module
from failstop.supervisor.children import RUNS, WAITING
from tests.support.stage import MOST_LATE, Dummy
from tests.support.supervisor_scene import MS, Scene


class Watching(Scene):
    """With real processes in the roles of the children; none is ever started again."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        monkeypatch.setattr(table_module.ProcessTable, "start", lambda _, child: child.restart.set(NEVER))
        self.supervisor.processes[layout.PORT_OWNER].state = WAITING
        self.dummies: list[Dummy] = []
        self.beats = {name: segment.attach(self.run.memory, name, write=True).word("beat_ns") for name in BY_NAME}

    def employ(self, name: str) -> Dummy:
        """A process that says that it runs."""
        dummy = Dummy()
        self.dummies.append(dummy)
        child = self.supervisor.processes[name]
        child.started(dummy.pid, 1 + len(self.dummies), self.now_ns)
        child.life.armed = True  # type: ignore[union-attr]
        self.supervisor.loop.watch(child.life.fd, READ)  # type: ignore[union-attr]
        own = segment.attach(self.run.memory, name, write=True)
        own.word("beat_pid").set(dummy.pid)
        own.word("beat_state").set(RUNNING)
        own.word("beat_ns").set(self.now_ns)
        child.on(RUNS)
        return dummy

    def pass_time(self, elapsed_ns: int) -> bytes:
        """A turn in which nobody beats."""
        self.now_ns += elapsed_ns
        self.supervisor.turn(self.supervisor.loop.wait(0))
        self.late = self.late + 1 if self.next_ns() <= self.now_ns else 0
        assert self.late <= MOST_LATE, "a timer was left behind: the loop would spin"
        try:
            return os.read(self.master, 65536)
        except OSError:  # nothing, or nobody has the port open any more
            return b""

    def enabled(self, epoch: int = 1) -> None:
        """The gate has enabled motion."""
        self.gate.latest_writer("state").write(pack({"enabled": True, "epoch": epoch}))

    def port_open(self) -> None:
        port = records.PORT.pack(1, self.now_ns, records.PORT_OPEN, "/dev/board")
        self.port_owner.latest_writer("port").write(port)

    def beat_but(self, name: str) -> None:
        """A tick in which everybody else beats."""
        for other, beat in self.beats.items():
            if other != name:
                beat.set(self.now_ns + 10 * MS)
        self.pass_time(10 * MS)

    def starved(self) -> list[tuple[str, int, int]]:
        """What people were told of the machine since the last call."""
        found = [event["fields"] for event in self.events() if event["kind"] == "starved"]
        return [(fields["process"], fields["silent_ms"], fields["times"]) for fields in found]

    def rung(self, process: str) -> bool:
        fd = self.run.bells[process].fd
        found = bool(select.select([fd], [], [], 0)[0])
        self.run.bells[process].clear()
        return found

    def close(self) -> None:
        for child in self.supervisor.children:
            if child.life:
                child.life.close()
        for dummy in self.dummies:
            with contextlib.suppress(ChildProcessError, ProcessLookupError):  # the supervisor has collected it
                dummy.close()
        super().close()
