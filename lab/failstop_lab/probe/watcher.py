"""Watcher: a process of its own that stops the wheels when the probe is done, falls silent, or is killed.

`python -m failstop_lab.probe.watcher PORT KIND BAUD`: standard input is its lifeline. Each line is `drive PID` (this
process drives now), `stop`, or `here`; it answers the first two with a line: `done`, `late` if it had to end the
driving by itself, or `unwritten` if no stop could be written. When nothing has come for SILENT_S while something
drives, it kills that and writes the board's stop. It does the same when standard input ends, and then waits for a port
that is unplugged until it has taken the stop. It has a session of its own, so Ctrl-C and a closed terminal do not reach
it. The watcher itself may hang or die: the probe waits for its answers only for a while, and then writes the stop
itself. publisher.py has a watcher for ROS 2.
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

from failstop import stop_tool
from failstop.api.errors import FailstopError
from failstop.board.kinds import board_of
from failstop.board.port import PortError

SILENT_S = 5.0
"""A probe that has said nothing for so long hangs, or is not run."""
HERE, STOP_WORD, DONE_WORD, LATE_WORD, UNWRITTEN_WORD = "here", "stop", "done", "late", "unwritten"
HERE_S = 1.0
"""Between two words of the probe's that it runs."""
ENDS_S = 0.5
"""How long a killed process may take to end. Then the stop is written anyway."""
WAITS_S = 300.0
"""The longest that it tries to have the port, at its end."""
WRITES = 5
APART_S = 0.1
STARTS_S = 15.0
"""How long a watcher may take to answer at first, on a busy machine, or at its end."""
ANSWERS_S = 3.0
"""How long it may take later: a stop is written WRITES times, and repeated by some boards' rules."""
WATCHER_GONE = "the probe's watcher process has ended, so the probe ended too: run it again"
WATCHER_HANGS = "the probe's watcher process did not answer, so it was killed, and the probe ended: run it again"
WATCHER_LATE = (
    "the computer was too busy to run this probe in time, so its watcher process killed the driver: run it again"
)
WATCHER_UNWRITTEN = "the probe's watcher process could not write the stop"


class Watcher:
    """The processes that drive now, and how to stop the wheels."""

    def __init__(self, halt: Callable[[float], bool]) -> None:
        """`halt(seconds)` writes the stop, waiting that long for a way to the wheels; False: it could not."""
        self._halt = halt
        self._drivers: list[int] = []
        """A pidfd of each process that drives."""
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
            if not select.select([0], [], [], SILENT_S if self._drivers else None)[0]:
                self._late = True
                self.stop(0.0)
                continue
            if not (data := os.read(0, 4096)):
                return
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._execute(line.decode())

    def _execute(self, line: str) -> None:
        verb, _, what = line.partition(" ")
        if verb == "drive":
            with contextlib.suppress(ProcessLookupError):  # it has ended already
                self._drivers.append(os.pidfd_open(int(what)))
        written = self.stop(0.0) if verb == STOP_WORD else True
        if verb != HERE:
            print(LATE_WORD if self._late else DONE_WORD if written else UNWRITTEN_WORD, flush=True)
            self._late = False

    def stop(self, wait_s: float) -> bool:
        """Kill the processes that drive, and write the stop; False: it could not be written."""
        for fd in self._drivers:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(fd, signal.SIGKILL)
        # A process that is killed in the middle of a write finishes that write, so it could come after the stop.
        until_s = time.monotonic() + ENDS_S
        for fd in self._drivers:
            select.select([fd], [], [], max(0.0, until_s - time.monotonic()))
            os.close(fd)
        self._drivers.clear()
        return self._halt(wait_s)


class Orders:
    """The probe's end of a watcher's lifeline."""

    def __init__(self, watcher: subprocess.Popen[str]) -> None:
        self._watcher = watcher
        self._here_s = 0.0
        self._answers_s = STARTS_S

    def give(self, line: str) -> None:
        """Tell it to drive or to stop, and wait for its answer: it must know what to stop before anything turns. A
        watcher that does not answer is killed. Raises FailstopError; the wheels may turn then."""
        self._write(line)
        answer = self._answer()
        self._answers_s = ANSWERS_S
        if not answer:
            raise FailstopError(WATCHER_GONE)
        if answer == LATE_WORD:
            raise FailstopError(WATCHER_LATE)
        if answer == UNWRITTEN_WORD:
            raise FailstopError(WATCHER_UNWRITTEN)

    def _answer(self) -> str:
        """Its next line; empty: it has ended. Raises FailstopError when none comes in time. It answers each order with
        one line, so nothing waits in the buffer of standard output."""
        output = self._watcher.stdout
        assert output
        if not select.select([output], [], [], self._answers_s)[0]:
            self._watcher.kill()
            raise FailstopError(WATCHER_HANGS)
        return output.readline().strip()

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


def _no_wait(_: PortError) -> float:
    return 0.0


def halting(path: str, kind: str, baud: str) -> Callable[[float], bool]:
    """Return what writes the stop of a board of this kind to this port, several times because one may be lost."""
    board = board_of(kind, 1.0, 0.0, baud=int(baud))

    def halt(wait_s: float) -> bool:
        written, wait = False, lambda _: wait_s
        for _ in range(WRITES):
            try:
                stop_tool.stop(lambda: stop_tool.write(path, board), wait, lambda _: None)
                written, wait = True, _no_wait  # a repeat need not wait for a port that has gone since
            except PortError:
                if wait_s:
                    break  # it has waited for as long as it may
            time.sleep(APART_S)
        return written

    return halt


if __name__ == "__main__":
    Watcher(halting(*sys.argv[1:])).run()
