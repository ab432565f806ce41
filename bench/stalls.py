"""`python -m bench.stalls CORE`: the control beside a soak. A bare loop that sleeps and notes when it woke late, with
nothing of failstop in it, memory locked, on one core, at a real-time priority above every process of the service. When
it stands still, the machine withheld the core: its kernel, or the host of a virtual machine.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

from failstop.procs import rights
from failstop.shm.heartbeat import REALTIME

PRIORITY = 60
"""SCHED_FIFO; the service's highest is 33."""
EVERY_S = 0.001
STEAL_EVERY = 100
"""Turns between two looks at the steal time."""
LONG_NS = 5_000_000
"""Shorter ones are not kept."""


@dataclasses.dataclass(frozen=True)
class Stall:
    """A core stood still: from when it should have turned until it did (CLOCK_MONOTONIC ns)."""

    core: int
    begin_ns: int
    end_ns: int
    stolen_ms: float
    """The time that the host says it took from this core in that time and the tenth of a second before it, to 10 ms."""

    @property
    def ms(self) -> float:
        """How long."""
        return (self.end_ns - self.begin_ns) / 1e6


class Control:
    """The loops of a soak, by their pids; `stalls` is there when they have ended."""

    def __init__(self, stalls: list[Stall] | None = None) -> None:
        self.stalls = stalls or []
        self.pids: list[int] = []

    def longest_ms(self, begin_ns: int, end_ns: int) -> float:
        """The longest stall of any core that touches this time; 0: none."""
        return max((one.ms for one in self.stalls if one.begin_ns <= end_ns and one.end_ns >= begin_ns), default=0.0)


@contextlib.contextmanager
def control() -> Iterator[Control]:
    """Watch every core that this process may use, for the length of a block. Raises OSError where real-time scheduling
    is not allowed: a control below the service says nothing of it."""
    found = Control()
    running: list[subprocess.Popen[str]] = []
    try:
        for core in sorted(os.sched_getaffinity(0)):
            command = [sys.executable, "-m", "bench.stalls", str(core)]
            running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        for process in running:
            assert process.stdout
            if process.stdout.readline() != "ready\n":
                raise PermissionError("the control may not have SCHED_FIFO: run it as root, or raise RLIMIT_RTPRIO")
        found.pids = [process.pid for process in running]
        yield found
    finally:
        for process in running:
            process.send_signal(signal.SIGTERM)
        for process in running:
            said, _ = process.communicate()
            found.stalls += (Stall(*one) for one in json.loads(said or "[]"))
        found.stalls.sort(key=lambda one: one.begin_ns)


def stolen_ms(core: int) -> float:
    """Steal time of a core since the start (proc(5))."""
    with open("/proc/stat", encoding="ascii") as file:
        for line in file:
            if line.startswith(f"cpu{core} "):
                return int(line.split()[8]) * 1000 / os.sysconf("SC_CLK_TCK")
    return 0.0


def _watch(core: int) -> list[tuple[int, int, int, float]]:
    """From the word "ready" on standard output until SIGTERM."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ended.append(number))
    found = []
    stolen = stolen_ms(core)
    gc.disable()
    period_ns = int(EVERY_S * 1e9)
    before_ns = time.monotonic_ns()
    print("ready", flush=True)
    turns = 0
    while not ended:
        time.sleep(EVERY_S)
        turns += 1
        if not turns % STEAL_EVERY:
            stolen = stolen_ms(core)
        now_ns = time.monotonic_ns()
        if now_ns - before_ns > LONG_NS + period_ns:
            was, stolen = stolen, stolen_ms(core)
            found.append((core, before_ns + period_ns, now_ns, stolen - was))
            now_ns = time.monotonic_ns()
        before_ns = now_ns
    return found


def main() -> int:
    """One core's loop."""
    core = int(sys.argv[1])
    os.sched_setaffinity(0, {core})
    return loop(core, rights.request_rights(PRIORITY))


def loop(core: int, taken: int) -> int:
    """`taken`: the rights that this process has. Exit code 1 without real-time priority: it would say nothing."""
    if not taken & REALTIME:
        return 1
    print(json.dumps(_watch(core)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
