"""The floors: what a kill costs with nothing around it.

An idle bare Python process is killed; another one, blocked on its pidfd, writes 59 bytes (the burst up to its first
stop frame) to the simulated board's pty. Both run under SCHED_FIFO where the service does, and the same board takes the
time. The same with a robust mutex instead of the pidfd: the victim holds it, the watcher blocks on it.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

from failstop.board.burst import BURST, FIRST_STOP_END
from failstop.board.sim.client import SimBoard
from failstop.shm.mutex import BLOCKS, MUTEX_BYTES, PER_BLOCK, Mutexes

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


_HOLD = """
import mmap, os, sys
sys.path[:] = {path!r}
from failstop.shm.mutex import BLOCKS, MUTEX_BYTES, PER_BLOCK, Mutexes
memory = mmap.mmap(os.open({file!r}, os.O_RDWR), BLOCKS * PER_BLOCK * MUTEX_BYTES)
mutexes = Mutexes(memory, 0)
mutexes.hold(0)
"""
_BALLAST = "ballast = b'x' * ({mb} << 20)\n"


def _watch_mutex(file: str, link: str, ready_fd: int) -> None:
    """The watcher that blocks on the victim's mutex, in a child of its own."""
    port = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    data = BURST[:FIRST_STOP_END]
    mutexes = _mutexes(file)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    os.write(ready_fd, b"x")
    mutexes.wait_for_death(0, 0)
    os.write(port, data)


def _mutexes(file: str) -> Mutexes:
    size = BLOCKS * PER_BLOCK * MUTEX_BYTES
    with open(file, "r+b") as opened:
        opened.truncate(size)
        return Mutexes(mmap.mmap(opened.fileno(), size), 0)


def mutex_sample(board: SimBoard, ballast_mb: int = 0) -> int:
    """One kill of a process that holds a robust mutex, of `ballast_mb` MB more than it needs; returns ns from the kill
    to the arrival of the last of the 59 bytes."""
    with tempfile.NamedTemporaryFile(dir="/dev/shm", prefix="failstop-floor-") as file:
        _mutexes(file.name).prepare(0)
        program = _BALLAST.format(mb=ballast_mb) + _HOLD.format(path=sys.path, file=file.name) + _IDLE
        return _killed(board, program, lambda _pid, tell: _watch_mutex(file.name, board.link, tell))


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
    return _killed(board, _IDLE, lambda pid, tell: _watch(pid, board.link, tell))


def _killed(board: SimBoard, program: str, watch: Callable[[int, int], None]) -> int:
    command = [sys.executable, "-I", "-S", "-c", program]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as victim:
        assert victim.stdout is not None
        victim.stdout.read(1)
        ready, tell = os.pipe()
        watcher = os.fork()
        if watcher == 0:
            try:
                watch(victim.pid, tell)
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
