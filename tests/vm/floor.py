"""In the guest: what noticing a death and writing to the board's port takes in Python at least.

python -m tests.vm.floor        prints, for each round, when the idle process was killed (CLOCK_MONOTONIC, ns)
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator

from failstop.board.port import close_port, open_port
from failstop.board.rrc.board import RRC_PORT
from failstop.board.rrc.framing import PWM_SERVO, frame
from failstop_lab.sim.client import Event

LINK = "/dev/failstop"
ROUNDS = 9
SETTLE_S = 0.05
PRIORITY = 33
"""The port owner's."""
FRAME = frame(PWM_SERVO, b"\x09\x02")
"""A question for the deviation of servo 2, which nobody else writes."""
IDLE = (sys.executable, "-I", "-S", "-c", "import time; print(flush=True); time.sleep(99)")


def is_of_floor(event: Event) -> bool:
    """Whether the board has executed that frame."""
    return event.func == PWM_SERVO and event.data == FRAME[4:-1]


def rounds() -> Iterator[int]:
    """Kill, notice, write; yields when each was killed."""
    fd = open_port(LINK, exclusive=False, line=RRC_PORT)
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    try:
        for _ in range(ROUNDS):
            with subprocess.Popen(IDLE, stdout=subprocess.PIPE) as idle:
                assert idle.stdout is not None
                idle.stdout.readline()
                pidfd = os.pidfd_open(idle.pid)
                time.sleep(SETTLE_S)
                since_ns = time.monotonic_ns()
                idle.kill()
                select.select([pidfd], [], [])
                os.write(fd, FRAME)
                os.close(pidfd)
            yield since_ns
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        close_port(fd)


if __name__ == "__main__":
    for killed_ns in rounds():
        print(killed_ns, flush=True)
        time.sleep(SETTLE_S)
