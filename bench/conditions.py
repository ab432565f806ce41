"""Conditions of a soak: a busy machine, and a service without real-time rights."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator

_PR_CAPBSET_DROP = 24
_CAP_SYS_NICE = 23

HOG = "while True: pass"
CHURN = "while True:\n    block = bytearray(64 << 20)\n    block[::4096] = bytes(len(block) // 4096)\n    del block"
WRITE = """
import os, sys
with open(sys.argv[1], "wb", buffering=0) as file:
    block = os.urandom(1 << 20)
    while True:
        for _ in range(256):
            file.write(block)
        os.fsync(file.fileno())
        file.truncate(0)
        file.seek(0)
"""


@contextlib.contextmanager
def load(directory: str) -> Iterator[None]:
    """A busy machine: a hog for each core and one more, one that takes and returns memory, one that writes to disk."""
    with tempfile.NamedTemporaryFile(dir=directory) as file:
        programs = [[HOG]] * ((os.cpu_count() or 1) + 1) + [[CHURN], [WRITE, file.name]]
        running = [subprocess.Popen([sys.executable, "-c", *words]) for words in programs]
        try:
            yield
        finally:
            for process in running:
                process.kill()
            for process in running:
                process.wait()


def renounce_realtime() -> None:
    """From here on nothing that this process starts may have SCHED_FIFO, root or not. For good. Raises OSError."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_CAPBSET_DROP, _CAP_SYS_NICE, 0, 0, 0):
            number = ctypes.get_errno()
            raise OSError(number, f"CAP_SYS_NICE can't be dropped: {os.strerror(number)}")
