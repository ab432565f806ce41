"""The floor: what a kill costs with nothing around it.

An idle bare Python process is killed; another one, blocked on its pidfd, writes 59 bytes (the burst up to its first
stop frame) to the simulated board's pty. Both run under SCHED_FIFO where the service does, and the same board takes the
time.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time

from failstop.board.burst import BURST, FIRST_STOP_END
from failstop.board.sim.client import SimBoard

PRIORITY = 30
_REALTIME = f"""
import os
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))
except PermissionError:
    pass
os.write(1, b"x")
"""
_IDLE = _REALTIME + "import time\ntime.sleep(1e6)\n"


def _watch(pid: int, link: str, ready_fd: int) -> None:
    """The watcher, in a child of its own."""
    port = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    data = BURST[:FIRST_STOP_END]
    life = os.pidfd_open(pid)
    epoll = select.epoll()
    epoll.register(life, select.EPOLLIN)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    os.write(ready_fd, b"x")
    epoll.poll()
    os.write(port, data)


def sample(board: SimBoard) -> int:
    """One kill; returns ns from the kill to the arrival of the last of the 59 bytes."""
    command = [sys.executable, "-I", "-S", "-c", _IDLE]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as victim:
        assert victim.stdout is not None
        victim.stdout.read(1)
        ready, tell = os.pipe()
        watcher = os.fork()
        if watcher == 0:
            try:
                _watch(victim.pid, board.link, tell)
            finally:
                os._exit(0)
        os.read(ready, 1)
        os.close(ready)
        os.close(tell)
        board.events()
        # The victim and the watcher must both be asleep.
        time.sleep(0.02)
        killed_ns = time.monotonic_ns()
        os.kill(victim.pid, signal.SIGKILL)
        event = board.wait_for(lambda event: event.is_stop and event.arrival_ns >= killed_ns, 5.0)
        os.waitpid(watcher, 0)
    return event.arrival_ns - killed_ns
