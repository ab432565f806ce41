"""A process that asks to be woken at regular moments and prints how late it was; started by ticks.py.

tick_child.py SECONDS PERIOD_S PRIORITY     0: ordinary scheduling
"""

from __future__ import annotations

import os
import select
import sys
import time


def measure(seconds: float, period_s: float) -> list[int]:
    """Nanoseconds late, one for each moment; those missed altogether are left out, as the gate does."""
    period_ns = round(period_s * 1e9)
    due_ns = time.monotonic_ns() + period_ns
    end_ns = due_ns + round(seconds * 1e9)
    late = []
    while due_ns < end_ns:
        if (wait_ns := due_ns - time.monotonic_ns()) > 0:
            select.select((), (), (), wait_ns / 1e9)
        now_ns = time.monotonic_ns()
        if now_ns < due_ns:
            continue
        late.append(now_ns - due_ns)
        due_ns = max(due_ns, now_ns - period_ns) + period_ns
    return late


def main(seconds: float, period_s: float, priority: int) -> int:
    """Print the numbers; exit code 1 when the priority is not granted."""
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError:
            return 1
    print(*measure(seconds, period_s))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])))
