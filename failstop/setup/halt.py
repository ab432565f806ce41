"""Halt: stops the wheels without a service, and finds out whether they have stopped. A program that turns wheels
through its own service uses this module after the service has ended.

Halt writes the board's stop directly to the port. Then it asks the board whether the stop has arrived, and reads the
board's reports about its wheels. If the port is unplugged, Halt tells the person, and writes the stop as soon as the
port is back.
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
"""How long to keep trying a port that exists but refuses the stop, s. Another process may be about to close the
port."""
WAITS_S = 300.0
"""How long to wait for an unplugged port, s."""
SETTLES_S = 0.3
"""How long a port must be missing before the person is told that it is unplugged, s. A port may also be missing for a
moment while it is being opened again."""
RETRY_S = 0.02
WRITES = 5
"""How many times a stop is written to a board that can't confirm it. A single stop may be lost on the line."""
APART_S = 0.1
STALE_S = 0.03
"""How long to wait after the port was opened, s. Until then, answers may still arrive to questions that an earlier
program has sent."""
ANSWERS_S = 0.25
"""How long to wait for the board's answer to one question, s. After that time, the stop and a question are sent
again."""
CONFIRMS_S = 1.5
"""How long to wait for the board's answer in total, s, including all repeats. If opening the port makes a board deaf
for a moment, this time begins after that moment."""
RESTS_S = 5.0
"""How long to wait until turning wheels are at rest, s."""
REST_S = 0.2
"""Wheels count as at rest after the board has reported them at rest for this long, s."""
REPORTS_S = 1.0
"""How long to wait for the board's first report about its wheels, s. A board that sends none in this time counts as one
that never reports."""
ASK_S = 0.05
TURN_S = 0.005
WAITING = f"{{}} is unplugged: {MAY_TURN}. Plug it in again, and the stop is written at once; Ctrl-C ends the waiting."


class Halt:
    """Stops the wheels of one board at one port. `last` is the outcome of the newest stop, or None before the first
    stop."""

    def __init__(self, path: str, board: Board, say: Callable[[str], None]) -> None:
        """`path`: the port. `say` prints a line for the person at the terminal."""
        self._path, self._board, self._say = path, board, say
        self.last: Halted | None = None

    def now(self, waits_s: float = WAITS_S) -> Halted:
        """Stop the wheels, and find out whether they have stopped. Raises nothing; the result describes each failure.
        If the port is unplugged, wait for it up to `waits_s`. Ctrl-C, SIGTERM and SIGHUP end only this waiting."""
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
                signals.clear()  # signals that came before the waiting must not end it
                with contextlib.suppress(OSError, ValueError):  # the terminal may be closed
                    self._say(WAITING.format(self._path))
            time.sleep(RETRY_S)

    def _asked(self) -> Halted:
        """Ask the board whether the stop has arrived. A board that can't tell gets the stop a few more times instead.
        Then wait for reports of wheels at rest, unless the board is silent or never reports wheels. Raises PortError,
        or OSError if the port disappears meanwhile."""
        board = self._board
        confirms = bool(board.pings)  # other boards report zero speed even if they never heard the stop
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
        """Repeat the stop and a question until the board answers. Returns False if the board has not answered within
        CONFIRMS_S."""
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
    """Wait until the board reports wheels at rest. Returns True once it has reported this for REST_S, False if the
    wheels did not come to rest in time, and None if the board reports nothing about its wheels. Raises OSError."""
    read_back = ReadBack(board.reports.apart_ns)
    begun_s = now_s = time.monotonic()
    ask_s = 0.0
    while now_s - begun_s < (RESTS_S if read_back.judged_ns else REPORTS_S):
        if board.ping_ns and now_s >= ask_s:  # this board reports its wheels only when asked
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
