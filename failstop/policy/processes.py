"""The process table: the processes of the service except the supervisor, in the order in which they are started."""

from __future__ import annotations

from failstop.data import Data

SUPERVISOR_PRIORITY = 30
"""The supervisor's real-time priority (SCHED_FIFO). A process with a higher priority runs first.

The port owner has the highest priority, because every stop goes through it. The next are the stopper, the gate and the
supervisor, in this order. The supervisor is the last of these four, because it is needed only after another process has
died. When the supervisor itself dies, the kernel still has to free its memory. The low priority lets the other three
processes run before this work.
"""

MS = 1_000_000
HANG_NS = 250 * MS
"""If the port owner hangs for this long, in ns, the stopper stops the robot. The stopper waits longer only if the port
owner lacks processor time and its last write to the wheels was a stop. If the port owner or the supervisor notices that
it has not run for this long, it stops the robot if the wheels may turn."""


class Process(Data):
    """One row of the process table: how a process is started and watched, and what its loss means."""

    name: str
    role: str
    priority: int
    deadline_ns: int
    outlives_supervisor: bool
    descriptors: tuple[str, ...]

    @property
    def module(self) -> str:
        return f"failstop.procs.{self.name}.main"


PROCESSES = (
    Process(
        "port_owner",
        role="owns the port and is the only process that writes motion frames",
        priority=33,
        deadline_ns=100 * MS,
        outlives_supervisor=True,
        descriptors=("port", "control", "stop", "bell", "supervisor_bell"),
    ),
    Process(
        "stopper",
        role="is a second way to stop, with its own descriptor of the port",
        priority=32,
        deadline_ns=250 * MS,
        outlives_supervisor=True,
        descriptors=("port", "control", "bell", "port_owner_bell", "supervisor_bell"),
    ),
    Process(
        "gate",
        role="decides every motion frame",
        priority=31,
        deadline_ns=250 * MS,
        outlives_supervisor=False,
        descriptors=("client_bell", "bell", "port_owner_bell", "supervisor_bell"),
    ),
    Process(
        "telemetry",
        role="decodes what the board sends",
        priority=20,
        deadline_ns=500 * MS,
        outlives_supervisor=False,
        descriptors=("port", "control", "bell", "port_owner_bell", "gate_bell", "supervisor_bell"),
    ),
)

PROCESS_BY_NAME = {row.name: row for row in PROCESSES}
ROLES = {**{row.name: row.role for row in PROCESSES}, "supervisor": "starts and watches the others"}
"""What each process does, in words that can follow the process's name and "which"."""
