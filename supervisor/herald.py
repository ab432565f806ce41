"""Herald: what the service manager is told each turn, put together from what the supervisor knows."""

from __future__ import annotations

import msgpack

from failstop.shm import layout
from failstop.supervisor import health

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.shm.segment import Segment
    from failstop.supervisor.latch import Latch
    from failstop.supervisor.notify import Notify
    from failstop.supervisor.process_table import ProcessTable

GATE_EVERY_NS = 100_000_000
"""The gate's state is decoded this often at most: it is new at every tick while something drives."""


class Herald:
    """One follow() a turn, after everything else."""

    def __init__(self, notify: Notify, processes: ProcessTable, latch: Latch, views: dict[str, Segment]) -> None:
        self.notify = notify
        self._processes = processes
        self._latch = latch
        self._gate_record = views[layout.GATE].latest_reader("state")
        self._gate: dict[str, Any] = {}
        self._gate_ns = 0
        self.fault = ""
        """Why the supervisor does not do its job: the watchdog is left to bite."""

    def follow(self, now_ns: int, missing: str, owed_since_ns: int, *, port_open: bool) -> None:
        """Status, watchdog. `missing`: what motion waits for; `owed_since_ns`, `port_open`: as in health.fault."""
        if not self.notify.active:
            return
        children = self._processes.children
        killed_ns = {child.row.name: child.fence.kill_ns for child in children if child.fence and child.pid}
        self.fault = health.fault(now_ns, killed_ns, owed_since_ns, port_open=port_open)
        down = ", ".join(child.row.name for child in children if child.state() == "down")
        if now_ns - self._gate_ns >= GATE_EVERY_NS:
            self._gate_ns = now_ns
            if entry := self._gate_record.read():
                self._gate = msgpack.unpackb(entry[2])
        latched = str(self._latch.stop.cause) if self._latch.stop else ""
        status = self.fault or health.status_line(missing, down, latched, self._gate)
        self.notify.follow(now_ns, status, healthy=not self.fault)
