"""Halt: stop the wheels from a program of failstop's own, and find out whether they are stopped.

It writes the board's stop to the port itself, without a service. Then it asks the board whether it has got the stop,
and reads what the board reports about its wheels. While the port is unplugged, it says so, waits, and writes the stop
as soon as the port is back.
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
"""For how long to keep trying if an existing port refuses the stop, s, because another process may be about to close
it."""
WAITS_S = 300.0
"""For how long to wait for a port that is unplugged, s."""
SETTLES_S = 0.3
"""A port must be gone for this long, s, before that is reported, because a port that is just being opened again is gone
for a moment."""
RETRY_S = 0.02
WRITES = 5
"""How often a stop is written to a board that can't confirm one, because a single stop may be lost on the line."""
APART_S = 0.1
STALE_S = 0.03
"""For how long answers to the questions of earlier programs may still arrive, s."""
ANSWERS_S = 0.25
"""How long one answer may take before the stop and the question are repeated."""
CONFIRMS_S = 1.5
"""How long the board may take to answer, with all repeats, s."""
RESTS_S = 5.0
"""How long turning wheels may take to come to rest, s."""
REST_S = 0.2
"""For how long the board must report that the wheels are at rest, s."""
REPORTS_S = 1.0
"""If a board has sent no report within this time, s, it counts as one that reports nothing."""
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
        """Stop the wheels, and find out whether they are stopped. It raises nothing. It waits up to `waits_s` for a
        port that is unplugged. Ctrl-C, SIGTERM and SIGHUP end only that waiting."""
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
        """Ask the board whether it has got the stop, and wait until it reports its wheels at rest. Raises PortError, or
        OSError if the port goes away in the meantime."""
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
        """True if the board has answered a question that followed a stop. Stops and questions are repeated."""
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
    """True once the board has reported for long enough that its wheels are at rest, False if it has not; None if it
    reports nothing about its wheels. Raises OSError."""
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
