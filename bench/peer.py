"""Peers: what a user would pick instead of failstop, to end a driver's motion when it dies."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from typing import Protocol

from bench import BenchError

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
"""Where `python -m bench.…` works."""
END_S = 10.0


class PeerMissing(Exception):
    """The peer cannot be measured here; says what it needs."""


class Peer(Protocol):
    """One way to have a stop written when the driver dies."""

    label: str

    def __init__(self, link: str) -> None:
        """Make ready to have a driver killed on the board at `link`. Raises PeerMissing."""

    def start(self) -> int:
        """Start the driver; returns its pid."""

    def settle(self) -> None:
        """Wait until what the driver's death set off has ended."""

    def close(self) -> None:
        """End everything that was started."""


class ExitHandler:
    """A parent process that starts the stop tool when the driver exits."""

    label = "parent starts `failstop stop` when the driver exits (a launch file's exit handler)"

    def __init__(self, link: str) -> None:
        self._command = [sys.executable, "-m", "bench.peer_parent", link]
        self._parent: subprocess.Popen[str] | None = None
        self._driver = 0

    def start(self) -> int:
        """A new parent, and its driver."""
        self._parent = subprocess.Popen(
            self._command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
        )
        assert self._parent.stdout is not None
        self._driver = int(self._parent.stdout.readline())
        return self._driver

    def settle(self) -> None:
        """Wait for the parent, which waits for the stop tool. Raises BenchError when the parent failed."""
        assert self._parent is not None
        code = self._parent.wait(END_S)
        self._collect()
        if code:
            raise BenchError(f"the parent of the stop tool failed with exit code {code}")

    def _collect(self) -> None:
        if self._parent is not None and self._parent.stdout is not None:
            self._parent.stdout.close()
        self._parent = None

    def close(self) -> None:
        """Kill the driver, if it still drives, and wait for its parent."""
        if self._parent is None:
            return
        if self._parent.poll() is None:
            # Its parent has not collected it, so the pid is still its own.
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._driver, signal.SIGKILL)
            try:
                self._parent.wait(END_S)
            except subprocess.TimeoutExpired:
                self._parent.kill()
                self._parent.wait()
        self._collect()
