"""Watcher: a process of its own that stops the wheels when the probe is done, falls silent, or is killed.

`python -m failstop.lab.probe.watcher PORT KIND`: standard input is its lifeline. Each line is `drive PID` (this process
drives now), `stop`, or `here`; it answers the first two by a line: done, or late where it has stopped the wheels by
itself. When nothing has come for SILENT_S while something drives, it kills that and writes the board's stop; when the
line ends, too, waiting for a port that is gone until it has taken the stop. It has a session
of its own: Ctrl-C and a closed terminal do not reach it. publisher.py has one for ROS 2.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable

from failstop import stopping
from failstop.api.errors import FailstopError
from failstop.board.kinds import board_of
from failstop.board.port import PortError

SILENT_S = 5.0
"""A probe that has said nothing for so long hangs, or is not run."""
HERE, STOP_WORD, DONE_WORD, LATE_WORD = "here", "stop", "done", "late"
HERE_S = 1.0
"""Between two words of the probe's that it runs."""
WAITS_S = 300.0
"""The longest that it tries to have the port, at its end."""
WRITES = 5
APART_S = 0.1
WATCHER_GONE = "the watcher has ended, and the wheels were stopped: repeat it; if a wheel turns, use the POWER SWITCH"


class Watcher:
    """The processes that drive now, and how the wheels are stopped."""

    def __init__(self, halt: Callable[[float], None]) -> None:
        """`halt`: stops the wheels, waiting for so many seconds for a way to them."""
        self._halt = halt
        self._pids: list[int] = []
        self._late = False
        """The wheels were stopped without an order, since the last answer."""

    def run(self) -> None:
        """Until the lifeline ends."""
        ignore_terminal()
        with contextlib.suppress(OSError):  # nobody reads the answer: the probe has ended
            self._obey()
        self.stop(WAITS_S)

    def _obey(self) -> None:
        rest = b""
        while True:
            if not select.select([0], [], [], SILENT_S if self._pids else None)[0]:
                self._late = True
                self.stop(0.0)
                continue
            if not (data := os.read(0, 4096)):
                return
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._take(line.decode())

    def _take(self, line: str) -> None:
        verb, _, what = line.partition(" ")
        if verb == "drive":
            self._pids.append(int(what))
        elif verb == STOP_WORD:
            self.stop(0.0)
        if verb != HERE:
            print(LATE_WORD if self._late else DONE_WORD, flush=True)
            self._late = False

    def stop(self, wait_s: float) -> None:
        """Kill what drives, and stop the wheels."""
        for pid in self._pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._pids.clear()
        self._halt(wait_s)


class Orders:
    """The probe's end of a watcher's lifeline."""

    def __init__(self, watcher: subprocess.Popen[str]) -> None:
        self._watcher = watcher
        self._here_s = 0.0

    def give(self, line: str) -> None:
        """Tell it to drive or to stop. The answer is awaited: it knows what it is to stop before anything turns. Raises
        FailstopError."""
        self._write(line)
        assert self._watcher.stdout
        answer = self._watcher.stdout.readline().strip()
        if not answer:
            raise FailstopError(WATCHER_GONE)
        if answer == LATE_WORD:
            raise FailstopError("the machine did not run this probe in time, and the wheels were stopped: repeat it")

    def here(self) -> None:
        """Say that this process runs, where that was long ago. Raises FailstopError when the watcher is gone."""
        if (now_s := time.monotonic()) >= self._here_s:
            self._here_s = now_s + HERE_S
            self._write(HERE)

    def _write(self, line: str) -> None:
        assert self._watcher.stdin
        try:
            self._watcher.stdin.write(f"{line}\n")
            self._watcher.stdin.flush()
        except OSError:
            raise FailstopError(WATCHER_GONE) from None


def ignore_terminal() -> None:
    """Live on without a terminal, and without whoever reads."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)


def halting(path: str, kind: str) -> Callable[[float], None]:
    """Return what stops the wheels of a board of this kind at this port. It writes several stops: one may be lost."""
    board = board_of(kind, 1.0, 0.0)

    def halt(wait_s: float) -> None:
        for _ in range(WRITES):
            try:
                stopping.stop(path, board, lambda _: wait_s, lambda _: None)
            except PortError:
                if wait_s:
                    return  # it has waited for as long as it may
            time.sleep(APART_S)

    return halt


if __name__ == "__main__":
    Watcher(halting(*sys.argv[1:])).run()
