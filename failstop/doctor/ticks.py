"""The timing self-test: two processes tick side by side, one with real-time priority if that is granted."""

from __future__ import annotations

import os
import subprocess
import sys

from failstop.doctor.facts import Ticks
from failstop.policy.processes import BY_NAME

SECONDS = 5.0
PERIOD_S = 0.01
"""Two moments for each of the gate's ticks."""
PRIORITY = BY_NAME["gate"].priority
CHILD = os.path.join(os.path.dirname(os.path.abspath(__file__)), "tick_child.py")
MICRO_NS = 1000


def measure(seconds: float = SECONDS) -> tuple[Ticks, ...]:
    """What the two found; without real-time rights only the ordinary one."""
    started = []
    for priority in (0, PRIORITY):
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
    median_us, p99_us, worst_us = (late_ns[round(last * share)] / MICRO_NS for share in (0.5, 0.99, 1.0))
    return Ticks(realtime, len(late_ns), median_us, p99_us, worst_us)
