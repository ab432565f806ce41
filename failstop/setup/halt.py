"""Halt: stop the wheels from a program of failstop's own, and find out whether they are stopped.

It writes the board's stop to the port itself, with no service in between, then asks the board and looks at what it
reports of its wheels. While the port is unplugged it says so, waits, and writes the stop as soon as the port is back.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable

from failstop import stop_tool
from failstop.board.interface import BY_WHEELS, HEARD_WHEELS, Board
from failstop.board.port import PortError, has_lines, open_port
from failstop.board.tap import Tap
from failstop.policy.halted import MAY_TURN, Halted
from failstop.procs.telemetry.readback import ReadBack
from failstop.setup.ending import noted

FREE_S = 5.0
"""How long a port that exists may refuse the stop: another process may be about to let go of it."""
WAITS_S = 300.0
"""How long it waits for a port that is unplugged."""
SETTLES_S = 0.3
"""How long a port may be gone before it says so: one that is being opened anew is gone for a moment."""
RETRY_S = 0.02
WRITES = 5
"""Stops to a board that can't confirm one: a single stop may be lost on the line."""
APART_S = 0.1
STALE_S = 0.03
"""How long answers to questions of earlier programs may still arrive."""
ANSWERS_S = 0.25
"""How long one answer may take before the stop and the question are repeated."""
CONFIRMS_S = 1.5
"""How long the board has for its answer, in all."""
RESTS_S = 5.0
"""How long turning wheels may take to come to rest."""
REST_S = 0.2
"""How long the board has to report them at rest."""
REPORTS_S = 1.0
"""A board whose first report takes longer than this reports nothing."""
ASK_S = 0.05
TURN_S = 0.005
WAITING = f"{{}} is unplugged: {MAY_TURN}. Plug it in again, and the stop is written at once; Ctrl-C ends the waiting."


class Halt:
    """Stops one board at one port. `last` is its newest outcome; None: it has not stopped anything yet."""

    def __init__(self, path: str, board: Board, say: Callable[[str], None]) -> None:
        """`say` prints a line for the person at the terminal."""
        self._path, self._board, self._say = path, board, say
        self.last: Halted | None = None

    def now(self, waits_s: float = WAITS_S) -> Halted:
        """Stop the wheels, and find out whether they are stopped; it raises nothing. It waits up to `waits_s` seconds
        for a port that is unplugged. Ctrl-C, SIGTERM and SIGHUP end that waiting, and nothing else."""
        with noted() as signals:
            self.last = self._stop(waits_s, signals)
        return self.last

    def _stop(self, waits_s: float, signals: list[int]) -> Halted:
        begun_s = time.monotonic()
        written = waiting = False
        while True:
            try:
                stop_tool.write(self._path, self._board)
                written = True
                return self._asked()
            except (PortError, OSError) as error:
                there, why = os.path.exists(self._path), str(error)
            written &= there
            waited_s = time.monotonic() - begun_s
            most_s = waits_s if waiting or not there else FREE_S
            if waited_s >= most_s or (waiting and signals):
                return Halted(self._path, written=written, there=there, why=why, confirms=written)
            if not (there or waiting) and waited_s >= SETTLES_S:
                waiting = True
                signals.clear()  # those came before there was anything to wait for
                with contextlib.suppress(OSError, ValueError):  # the terminal may have gone
                    self._say(WAITING.format(self._path))
            time.sleep(RETRY_S)

    def _asked(self) -> Halted:
        """Ask the board whether it has the stop, and wait until it reports its wheels at rest. Raises PortError,
        OSError when the port goes away meanwhile."""
        board = self._board
        confirms = bool(board.pings)  # a board that only reports what it obeys reports zero without hearing a stop too
        fd = open_port(self._path, exclusive=False, line=board.port)
        try:
            tap = Tap(fd, board)
            time.sleep(STALE_S)
            tap.read()
            confirmed = self._confirmed(tap) if confirms else self._repeated()
            asks = board.observed_by == BY_WHEELS and (confirmed or not confirms)
            still = _still(tap, board) if asks else None
        finally:
            os.close(fd)
        return Halted(self._path, written=True, confirms=confirms, confirmed=confirmed, still=still)

    def _confirmed(self, tap: Tap) -> bool:
        """Whether the board has answered a question that followed a stop. Stops and questions are repeated."""
        deaf_s = self._board.port.deaf_ns / 1e9 * has_lines(tap.fd)
        hears_s, deaf = time.monotonic() + deaf_s, deaf_s > 0
        while tap.answered_ms(ANSWERS_S) is None:
            now_s = time.monotonic()
            if now_s >= hears_s + CONFIRMS_S:
                return False
            if deaf and now_s >= hears_s:
                deaf = False
                tap.lost()
            stop_tool.write(self._path, self._board)
        return True

    def _repeated(self) -> bool:
        for _ in range(WRITES - 1):
            time.sleep(APART_S)
            stop_tool.write(self._path, self._board)
        return False


def _still(tap: Tap, board: Board) -> bool | None:
    """Whether the board reports its wheels at rest, as soon as that has lasted; None: it reports nothing of them.
    Raises OSError."""
    read_back = ReadBack()
    begun_s = now_s = time.monotonic()
    ask_s = 0.0
    while now_s - begun_s < (RESTS_S if read_back.judged_ns else REPORTS_S):
        if board.ping_ns and now_s >= ask_s:  # such a board reports its wheels when it is asked
            ask_s = now_s + ASK_S
            with contextlib.suppress(BlockingIOError):
                tap.ping()
        for at_ns, kind, said in tap.read():
            if kind == HEARD_WHEELS:
                speeds, positions = said
                read_back.add(speeds, positions, at_ns)
        if read_back.still_ns and read_back.judged_ns - read_back.still_ns >= REST_S * 1e9:
            return True
        time.sleep(TURN_S)
        now_s = time.monotonic()
    return False if read_back.judged_ns else None
