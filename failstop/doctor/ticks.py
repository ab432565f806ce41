"""Ticks: how late a process is woken, measured by a child of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import NamedTuple

from failstop.policy.processes import BY_NAME

TICKS_S = 5.0
PERIOD_S = 0.01
"""Two moments for each of the gate's ticks."""
CHILD = os.path.join(os.path.dirname(os.path.abspath(__file__)), "tick_child.py")


class Ticks(NamedTuple):
    """How late a process was woken, against the moments that it asked for."""

    realtime: bool
    times: int
    median_us: float
    p99_us: float
    worst_us: float


def measure(seconds: float = TICKS_S) -> tuple[Ticks, ...]:
    """Two processes that tick side by side, one with real-time priority; without it where that is refused."""
    started = []
    for priority in (0, BY_NAME["gate"].priority):
        command = [sys.executable, "-I", "-S", CHILD, str(seconds), str(PERIOD_S), str(priority)]
        started.append((priority, subprocess.Popen(command, stdout=subprocess.PIPE, text=True)))
    found = []
    for priority, process in started:
        with process:
            try:
                said, _ = process.communicate(timeout=seconds + 10.0)
            except BaseException:
                process.kill()
                raise
        if process.returncode == 0 and (late := sorted(map(int, said.split()))):
            found.append(summary(late, realtime=priority > 0))
    return tuple(found)


def summary(late_ns: list[int], *, realtime: bool) -> Ticks:
    """Of sorted times, at least one."""
    last = len(late_ns) - 1
    median_us, p99_us, worst_us = (late_ns[round(last * share)] / 1000 for share in (0.5, 0.99, 1.0))
    return Ticks(realtime, len(late_ns), median_us, p99_us, worst_us)
