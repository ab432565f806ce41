"""The floors: what a kill costs with nothing around it.

The floor of the kill rows is a C program (floor.c): an idle process that holds a robust mutex is killed, another one,
blocked on it, writes 59 bytes (the burst up to its first stop frame) to the simulated board's pty. Both run under
SCHED_FIFO with their memory locked, and the same board takes the time. Beside it, to compare with: a bare Python
process killed, another one blocked on its pidfd.
"""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from types import TracebackType

from bench import BenchError
from failstop.board.rrc.burst import BURST, FIRST_STOP_END
from failstop_lab.sim.client import SimBoard

PRIORITY = 30
ASLEEP_S = 0.02
"""After so long the victim and its watcher are both asleep."""
_REALTIME = f"""
import os
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))
except PermissionError:
    pass
os.write(1, b"x")
"""
_IDLE = _REALTIME + "import time\ntime.sleep(1e6)\n"


class Floor:
    """The C program, compiled and at work; a context manager."""

    def __init__(self, board: SimBoard) -> None:
        """Raises BenchError without a C compiler."""
        compiler = shutil.which("cc") or shutil.which("gcc")
        if not compiler:
            raise BenchError("no C compiler for the floor of the kills: apt install gcc libc6-dev")
        self._board = board
        with tempfile.TemporaryDirectory(prefix="failstop-floor-") as directory:
            program = os.path.join(directory, "floor")
            source = os.path.join(os.path.dirname(__file__), "floor.c")
            subprocess.run([compiler, "-O2", "-Wall", "-pthread", "-o", program, source], check=True)
            words = [program, board.link, str(PRIORITY), BURST[:FIRST_STOP_END].hex()]
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self.sample()  # the file is needed until it has started

    def __enter__(self) -> Floor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with self._process as process:
            assert process.stdin is not None
            process.stdin.close()

    def sample(self) -> int:
        """One kill; returns ns from the kill to the arrival of the last of the 59 bytes."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(b"\n")
        stdin.flush()
        victim = int(stdout.readline())
        self._board.events()
        time.sleep(ASLEEP_S)
        killed_ns = time.monotonic_ns()
        os.kill(victim, signal.SIGKILL)
        event = self._board.wait_for(lambda event: event.is_stop and event.arrival_ns >= killed_ns, 5.0)
        return event.arrival_ns - killed_ns


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


def pidfd_sample(board: SimBoard) -> int:
    """One kill of a bare Python process that another one watches; returns ns as Floor.sample()."""
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
        time.sleep(ASLEEP_S)
        killed_ns = time.monotonic_ns()
        os.kill(victim.pid, signal.SIGKILL)
        event = board.wait_for(lambda event: event.is_stop and event.arrival_ns >= killed_ns, 5.0)
        os.waitpid(watcher, 0)
    return event.arrival_ns - killed_ns
