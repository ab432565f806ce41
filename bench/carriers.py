"""Carriers: the kernel's workers that take bytes from one end of a pty to the other.

A write to a USB port submits the transfer itself, and interrupts carry it on. A write to a pty only queues work for a
worker of ordinary priority, which waits wherever it is for whatever runs there: most of all behind the end of the very
process that was killed, 8 to 14 ms for the ROS 2 bridge, and behind what the service does once the stop is written.
Here they have the priority of the kernel's interrupt threads, which carry a USB port's bytes; the bytes still come to
the board when it reads them.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from types import TracebackType

_KTHREADD = 2
_PRIORITY = 50
"""The real-time priority of interrupt threads (Linux, kernel/sched/syscalls.c, sched_set_fifo())."""


class Kernel:
    """The workers and their scheduling, as the kernel tells and sets them."""

    def workers(self) -> Iterator[int]:
        """Pids of the workers."""
        return workers()

    def policy(self, pid: int) -> int:
        """Policy of one of them. Raises ProcessLookupError."""
        return os.sched_getscheduler(pid)

    def schedule(self, pid: int, policy: int, priority: int) -> None:
        """Give one another policy. Raises PermissionError, ProcessLookupError."""
        os.sched_setscheduler(pid, policy, os.sched_param(priority))


class Carriers:
    """A context manager; at its end the workers are as they were. It needs CAP_SYS_NICE, and does nothing without."""

    def __init__(self, kernel: Kernel | None = None) -> None:
        self._kernel = kernel or Kernel()
        self._changed: set[int] = set()
        self.priority = "ordinary"
        """The scheduling that they have had: real-time or ordinary."""

    def __enter__(self) -> Carriers:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for pid in self._changed & set(self._kernel.workers()):
            with contextlib.suppress(ProcessLookupError):
                self._kernel.schedule(pid, os.SCHED_OTHER, 0)

    def first(self) -> None:
        """Call before each measurement: workers come and go."""
        for pid in self._kernel.workers():
            with contextlib.suppress(PermissionError, ProcessLookupError):
                if self._kernel.policy(pid) == os.SCHED_OTHER:
                    self._kernel.schedule(pid, os.SCHED_FIFO, _PRIORITY)
                    self._changed.add(pid)
                    self.priority = "real-time"


def workers() -> Iterator[int]:
    """The kernel's workers that belong to no core: a pty's bytes are carried by one of them."""
    for name in os.listdir("/proc"):
        if name.isdigit():
            with contextlib.suppress(OSError), open(f"/proc/{name}/stat", encoding="utf-8", errors="replace") as file:
                comm, _, rest = file.read().partition("(")[2].rpartition(")")
                if comm.startswith("kworker/u") and int(rest.split()[1]) == _KTHREADD:
                    yield int(name)
