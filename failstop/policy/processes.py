"""The process table: every process of the service except the supervisor, in the order in which they are started."""

from __future__ import annotations

from failstop.data import Data

SUPERVISOR_PRIORITY = 30
"""SCHED_FIFO priorities; the higher one runs first. The port owner is first, because every stop goes through it. The
supervisor is last: it is needed when the others have died, and its death must not hold up the ones that answer it."""

MS = 1_000_000
HANG_NS = 250 * MS
"""After a hang no wheel turns for longer than this. The stopper notices a hang of the port owner; the supervisor and
the port owner each notice that they were held up themselves."""


class Process(Data):
    """One row of the table: a process, how it is started and watched, and what its loss means."""

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
"""The job of each process, as words that end a sentence."""
