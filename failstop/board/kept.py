"""Kept: the stop of your own board as plain numbers and bytes, which the service keeps in its runtime directory.

The description of your own board is a program, so it may be broken. With the kept stop, `failstop stop` works even
then.
"""

from __future__ import annotations

from failstop.board.interface import Board
from failstop.board.wire import MOST_REPEATS, Port

FIELDS = 7
LONGEST_BURST = 4096
"""The longest stop burst that is accepted, in bytes."""
MOST_NS = 2_000_000_000
"""The longest time that is accepted in a kept stop, in ns."""


def pack_stop(board: Board) -> str:
    """Return a board's stop as one line of text for unpack_stop(). The line has only the supervisor's row of
    Board.repeats_ns, and unpack_stop() gives this row to all writers."""
    port = board.port
    numbers = (port.baud, int(port.dtr), int(port.rts), board.idle_ns, board.after_ns)
    repeats = ",".join(map(str, board.repeats_ns[-1]))
    return " ".join((*map(str, numbers), repeats or "-", board.burst.hex()))


def unpack_stop(kept: str) -> Kept | None:
    """Return the stop in a line that pack_stop() has made, or None for any other line."""
    words = kept.split(" ")
    try:
        baud, dtr, rts, idle_ns, after_ns = map(int, words[:5])
        repeats = () if words[5] == "-" else tuple(map(int, words[5].split(",")))
        burst = bytes.fromhex(words[6])
    except (ValueError, IndexError):
        return None
    times = (idle_ns, after_ns, *repeats)
    fits = len(words) == FIELDS and 0 < len(burst) <= LONGEST_BURST and len(repeats) < MOST_REPEATS
    if not fits or not all(0 <= ns <= MOST_NS for ns in times) or baud <= 0:
        return None
    return Kept(Port(baud=baud, dtr=bool(dtr), rts=bool(rts), deaf_ns=0, opening=()), idle_ns, after_ns, repeats, burst)


class Kept(Board):
    """A board with nothing but its stop. It can't be asked anything."""

    __slots__ = ("after_ns", "burst", "first_stop", "idle_ns", "port", "repeats_ns", "stop")

    pings = ()
    echo_ns = 0
    arm = None
    name = "your own board"

    def __init__(self, port: Port, idle_ns: int, after_ns: int, repeats_ns: tuple[int, ...], burst: bytes) -> None:
        self.port, self.idle_ns, self.after_ns = port, idle_ns, after_ns
        self.repeats_ns = (repeats_ns,) * 3
        self.burst = self.first_stop = self.stop = burst
