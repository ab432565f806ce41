"""The supervisor, turn by turn inside the test: the test moves its clock, and is all of its processes and its port."""

from __future__ import annotations

import itertools
import os
import pty
import signal
import tty
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.policy import causes
from failstop.policy.reply import unpack
from failstop.policy.settings import Settings
from failstop.procs import rights
from failstop.shm import layout, records, segment
from failstop.shm.heartbeat import RUNNING
from failstop.supervisor import children, main
from failstop.supervisor.events import Outbox
from failstop.supervisor.main import Supervisor
from failstop.supervisor.port import OwnPort
from failstop.supervisor.run import Run
from failstop.supervisor.status import Notify
from tests.support.played import PlayedWorld
from tests.support.ptys import fill
from tests.support.stage import MOST_LATE
from tests.support.why import said, told, why

MS = 1_000_000
_numbers = itertools.count()


class Scene:
    """A supervisor without children on a pty, with a clock that the test moves; the test plays the port owner."""

    def __init__(
        self, directory: Path, monkeypatch: pytest.MonkeyPatch, *, granted: int = 0, journal: Outbox | None = None
    ) -> None:
        self.now_ns = 40_000 * MS
        self.late = 0
        self.world = PlayedWorld(now_ns=lambda: self.now_ns, sleep=self.sleep)
        monkeypatch.setattr(rights, "take_rights", lambda priority: granted)
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        for fd in (self.master, slave):
            os.set_blocking(fd, False)
        self.run = Run(self.world, Settings(), f"a{os.getpid()}x{next(_numbers)}", str(directory), journal)
        self.port = OwnPort(slave, unsent_bytes=self.world.unsent_bytes)
        self.supervisor = Supervisor(self.run, self.port, Notify())
        self.run.publish()
        memory = self.run.memory
        self.port_owner = segment.attach(memory, layout.PORT_OWNER, write=True)
        self.gate = segment.attach(memory, layout.GATE, write=True)
        self.stop_record = segment.attach(memory, layout.SUPERVISOR).latest_reader("stop")
        self.word = segment.attach(memory, layout.SUPERVISOR).word
        self._events = segment.attach(memory, layout.SUPERVISOR).ring_reader("events")
        child = self.supervisor.processes[layout.PORT_OWNER]
        child.state = children.RUNNING
        child.pid = 2**31 - 1  # no such process; it beats at every turn, so that nobody kills it
        self.port_owner.word("beat_pid").set(child.pid)
        self.port_owner.word("beat_state").set(RUNNING)
        self.port_owner.word("beat_ns").set(self.now_ns)
        port = records.PORT.pack(1, self.now_ns, records.PORT_OPEN, "/dev/board")
        self.port_owner.latest_writer("port").write(port)
        self.answers(written_ns=self.now_ns - 10_000 * MS)

    def sleep(self, seconds: float) -> None:
        """The supervisor sleeps."""
        self.now_ns += round(seconds * 1e9)

    def answers(self, *, written_ns: int = 0) -> None:
        """The port owner answers the epoch; `written_ns`: with a burst written then."""
        if written_ns:
            self.port_owner.word("written_ns").set(written_ns)
        self.port_owner.word("stopped_epoch").set(self.supervisor.epoch)

    def notice(self, reason: str = "key1", *, written_ns: int = 0) -> None:
        """The port owner has stopped for a cause of its own."""
        stop = records.STOPPED.pack(1, self.now_ns, written_ns, why(reason).pack())
        self.port_owner.ring_writer("stops").put(stop)

    def gate_stops(self, reason: str = "multiple cmd_vel publishers") -> None:
        """The gate has latched."""
        self.gate.ring_writer("stops").put(records.STOPPED.pack(1, self.now_ns, 0, why(reason).pack()))

    def turn(self, elapsed_ns: int = 0) -> bytes:
        """Time passes and the supervisor wakes up; returns what it wrote to the port."""
        self.now_ns += elapsed_ns
        self.port_owner.word("beat_ns").set(self.now_ns)
        self.supervisor.turn(self.supervisor.loop.wait(0))
        self.late = self.late + 1 if self.next_ns() <= self.now_ns else 0
        assert self.late <= MOST_LATE, "a timer was left behind: the loop would spin"
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""

    def next_ns(self) -> int:
        """When it turns without any news."""
        return min(self.now_ns + main.TICK_NS, self.supervisor.loop.due_ns())

    def events(self) -> list[dict[str, Any]]:
        """What people were told since the last call."""
        found = []
        while entry := self._events.next():
            found.append(msgpack.unpackb(entry[2]))
        return found

    def told(self) -> dict[str, Any]:
        entry = self.stop_record.read()
        assert entry is not None
        found: dict[str, Any] = msgpack.unpackb(entry[2])
        times = {key: found[key] for key in ("written_by", "written_us")}
        return {"reason": said(causes.read(found["cause"])), **times}

    def cause(self) -> tuple[int, str]:
        """What everybody reads: since which epoch it is latched (0: it is not), and the cause."""
        entry = segment.attach(self.run.memory, layout.SUPERVISOR).latest_reader("latch").read()
        assert entry is not None
        since, _, _, cause = records.LATCH.unpack(entry[2])
        return since, said(causes.read(cause))

    def ask_reset(self, asked_ns: int | None = None) -> None:
        """The gate passes a reset on."""
        self.gate.word("reset_asked_ns").set(asked_ns or self.now_ns)
        self.gate.word("resets_asked").set(self.gate.word("resets_asked").get() + 1)

    def decided(self) -> tuple[bool, str] | None:
        """What became of the last reset; None: it is not decided."""
        if self.word("resets").get() != self.gate.word("resets_asked").get():
            return None
        entry = segment.attach(self.run.memory, layout.SUPERVISOR).latest_reader("reset").read()
        assert entry is not None
        return told(unpack(entry[2])[2])

    def reset(self) -> None:
        """Somebody resets, and it is done."""
        self.ask_reset()
        self.turn(MS)
        assert self.decided() is not None

    def fill(self) -> None:
        """The port takes nothing more."""
        fill(self.port.fd, self.master)

    def close(self) -> None:
        self.run.remove()
        for control in self.supervisor.handover.controls.values():
            control.close()
        os.close(self.supervisor.handover.opener._spare)
        for pair in self.run.controls.values():
            os.close(pair[1])
        for fd in (self.master, self.run.stop_pipe, self.run.client_bell, self.run.published):
            os.close(fd)
        for bell in (*self.run.bells.values(), self.supervisor.processes.early.bell):
            os.close(bell.fd)
        for pid, saver in self.supervisor.blackbox._savers.items():
            os.killpg(pid, signal.SIGKILL)
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
            self.world.reap(pid)
            saver.close()
        self.port.close()
