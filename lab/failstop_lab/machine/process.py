"""Process: a process of a simulated machine, its threads, and what ends them.

A thread is a greenlet. It runs until a call of the simulated system blocks.
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from greenlet import GreenletExit, greenlet

if TYPE_CHECKING:
    from failstop_lab.machine.files import Open
    from failstop_lab.machine.kernel import Machine

SCHED_FIFO = 1


class Replaced(BaseException):
    """A process becomes another program, with these arguments."""

    def __init__(self, argv: list[str]) -> None:
        super().__init__()
        self.argv = argv


class Death(GreenletExit, GeneratorExit):  # type: ignore[misc]  # greenlet has no types
    """A call of a process that has died: it changes nothing any more. A greenlet and a generator end by it without a
    report."""


class Thread:
    """A thread of a process. It is `waiting` while a call of it blocks."""

    __slots__ = (
        *(
            "body",
            "greenlet",
            "number",
            "process",
            "ready",
            "robust",
            "scheduling",
            "token",
            "view",
            "waiting",
            "woken",
        ),
    )

    def __init__(self, process: Process, body: Callable[[], object], number: int, hub: greenlet | None = None) -> None:
        """`hub`: the greenlet of a thread that runs inline."""
        self.process = process
        self.body = body
        self.number = number
        self.greenlet = hub or greenlet(self._run, process.machine.hub)
        self.ready = False
        """If the thread runs inline: its turn has come."""
        self.robust: list[Any] = []
        """Futexes that the kernel marks at its death."""
        self.scheduling = (SCHED_FIFO, 10)
        """Policy and priority: every process of a service has real-time rights here."""
        self.token = 0
        """Counts its waits, so that a timer of an earlier one wakes nobody."""
        self.view: Any = None
        """The state of its processor, in a weak memory (buffers.py)."""
        self.waiting = False
        self.woken = False

    def _run(self) -> None:
        self.process.machine.finish(self, self.body)


class Process:
    """A process: its descriptors, threads, environment and signal handlers."""

    def __init__(self, machine: Machine, pid: int, parent: Process | None, name: str, environ: dict[str, str]) -> None:
        self.machine = machine
        self.pid = pid
        self.parent = parent
        self.group: int = parent.group if parent else pid
        """Its process group: what is sent to that comes to all in it."""
        self.name = name
        self.environ = environ
        machine.processes[pid] = self
        self.files: dict[int, Open] = {}
        self.inheritable: set[int] = set()
        self.threads: list[Thread] = []
        self.handlers: dict[int, Any] = {}
        self.pending: deque[int] = deque()
        self.in_write: Callable[[], None] | None = None
        """Puts the bytes on the wire that it is handing to the kernel: a death waits for it."""
        self.dead = False
        self.code: int | None = None
        """Exit code, or the negative signal; None: it lives, or its end is not yet complete."""
        self.reaped = False
        self.dies_with_parent = False
        self.held_since_ns = self.held_until_ns = 0
        """Runs nothing before that: stopped, or not run by the machine."""
        self.resumed_ns = 0
        """When it was let go on last."""
        self.starved = False
        """It is the machine that does not run it."""
        self.continued = False
        """A SIGCONT has come, and nobody has asked for it yet."""
        self.parked: list[Thread] = []
        self.watchers: list[Open] = []
        """Pidfds."""
        self.uid: int = parent.uid if parent else 0
        self.gid: int = parent.gid if parent else 0
        self.umask: int = parent.umask if parent else 0o22
        self.sys_path: list[str] = []
        self.argv: list[str] = []
        self.most_files = 1 << 20
        """A descriptor is below this (RLIMIT_NOFILE)."""
        self._random = pid

    def descriptor(self, opened: Open, lowest: int = 3) -> int:
        """The lowest free number, for an open file."""
        fd = lowest
        while fd in self.files:
            fd += 1
        if fd >= self.most_files:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        self.files[fd] = opened
        opened.references += 1
        return fd

    def random_bytes(self, most: int) -> bytes:
        """Random bytes that depend only on the machine's seed, this process's number and the calls before."""
        self._random = (self._random * 6364136223846793005 + self.machine.seed + 1442695040888963407) % (1 << 64)
        return (self._random.to_bytes(8, "little") * (most // 8 + 1))[:most]

    def close(self, fd: int) -> None:
        """Give a descriptor back."""
        opened = self.files.pop(fd)
        self.inheritable.discard(fd)
        opened.release()
