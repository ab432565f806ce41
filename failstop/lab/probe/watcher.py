"""Watcher: a process of its own that stops the wheels when the probe is done, falls silent, or is killed.

`python -m failstop.lab.probe.watcher PORT KIND`: standard input is its lifeline. Each line is `drive PID` (this process
drives now), `stop`, or `here`; it answers the first two by a line: done, or late where it has stopped the wheels by
itself. When nothing has come for SILENT_S while something drives, it kills that and writes the board's stop; when the
line ends, too, waiting for a port that is gone until it has taken the stop. It has a session
of its own: Ctrl-C and a closed terminal do not reach it.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time

from failstop import stopping
from failstop.board.kinds import board_of
from failstop.board.port import PortError

SILENT_S = 5.0
"""A probe that has said nothing for so long hangs, or is not run."""
HERE = "here"
WAITS_S = 300.0
"""The longest that it tries to have the port, at its end."""
WRITES = 5
APART_S = 0.1


class Watcher:
    """The process that drives now, and the port."""

    def __init__(self, path: str, kind: str) -> None:
        self._path, self._board = path, board_of(kind, 1.0, 0.0)
        self._pid = 0
        self._late = False
        """The wheels were stopped without an order, since the last answer."""

    def run(self) -> None:
        """Until the lifeline ends."""
        rest = b""
        while True:
            if not select.select([0], [], [], SILENT_S if self._pid else None)[0]:
                self._late = True
                self.stop(0.0)
                continue
            if not (data := os.read(0, 4096)):
                break
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._take(line.decode())
        self.stop(WAITS_S)

    def _take(self, line: str) -> None:
        verb, _, what = line.partition(" ")
        if verb == "drive":
            self._pid = int(what)
        elif verb == "stop":
            self.stop(0.0)
        if verb != HERE:
            print("late" if self._late else "done", flush=True)
            self._late = False

    def stop(self, wait_s: float) -> None:
        """Kill what drives, and write the stop. A board takes several: one alone may be lost on its way."""
        if self._pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            self._pid = 0
        for _ in range(WRITES):
            try:
                stopping.stop(self._path, self._board, lambda _: wait_s, lambda _: None)
            except PortError:
                if wait_s:
                    return  # it has waited for as long as it may
            time.sleep(APART_S)


def main(words: list[str]) -> None:
    """See above."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # The probe's end is its own end too: nobody reads any more.
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    watcher = Watcher(*words)
    try:
        watcher.run()
    except OSError:
        watcher.stop(WAITS_S)


if __name__ == "__main__":
    main(sys.argv[1:])
