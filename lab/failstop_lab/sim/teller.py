"""The board's orders, in as many lines as a person reads: changes of the wheels, stop bursts, counts of the rest.

Pure but for `say`: all times are those of the frames.
"""

from __future__ import annotations

from collections.abc import Callable

from failstop.board.rrc.board import BOARD
from failstop.board.rrc.framing import AUX_FUNCS, MOTOR
from failstop_lab.sim.model import Frame, Speeds, commands_stop

LINE_EVERY_S = 1.0
"""While a speed is ramped, one line a second."""
SETTLED_S = 0.15
"""A speed that held for so long is told; it is repeated every 0.2 s."""
BURST_GAP_S = 0.12
"""Stop frames that follow so soon belong to one stop: its burst is repeated after 20 and 100 ms."""
BURST_LEAST = 3
"""So many are more than the gate's own zero frames, which come every 0.2 s."""
COUNT_EVERY_S = 10.0
NAMES = dict(zip(AUX_FUNCS, ("system", "LED", "buzzer", "servo", "bus servo", "OLED", "RGB"), strict=True))
_PINGS = frozenset((ping[2], ping[4:-1]) for ping in BOARD.pings)
"""(function, data) of each."""


class Teller:
    """Hand every executed frame to frame(), in order."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._first_ns: int | None = None
        self._speeds: Speeds = ()
        self._changed_ns = 0
        self._told: Speeds = ()
        self._told_ns = 0
        self._stops = 0
        """How many stop frames have come in close succession."""
        self._stop_ns = 0
        self._counts: dict[str, int] = {}
        self._counted_ns = 0

    def frame(self, frame: Frame) -> None:
        """Tell what is new by it."""
        now_ns = frame.executed_ns
        if self._first_ns is None:
            self._first_ns = self._counted_ns = now_ns
            self._speeds = self._told = (0.0,) * len(frame.speeds)
        self._end_count(now_ns)
        self._wheels(frame)
        if commands_stop(frame.func, frame.data):
            self._stop(now_ns)
        else:
            self._count(_kind(frame))
        if frame.wild:
            self._line(now_ns, f"written OUTSIDE the motor table: {', '.join(f'{i} = {rps}' for i, rps in frame.wild)}")

    def _wheels(self, frame: Frame) -> None:
        now_ns = frame.executed_ns
        if frame.speeds != self._speeds:
            self._speeds, self._changed_ns = frame.speeds, now_ns
        if self._speeds == self._told:
            return
        settled = frame.func == MOTOR and (now_ns - self._changed_ns) / 1e9 >= SETTLED_S
        if settled or (now_ns - self._told_ns) / 1e9 >= LINE_EVERY_S or _signs(self._speeds) != _signs(self._told):
            self._told, self._told_ns = self._speeds, now_ns
            wheels = "  ".join(f"{speed:+7.3f}" for speed in self._speeds)
            self._line(now_ns, f"{'wheels turn' if any(self._speeds) else 'wheels stop'}  {wheels} rps")

    def _stop(self, now_ns: int) -> None:
        """Told as soon as it is a burst; the frames that repeat it are counted."""
        if (now_ns - self._stop_ns) / 1e9 > BURST_GAP_S:
            self._stops = 0
        self._stops, self._stop_ns = self._stops + 1, now_ns
        if self._stops == BURST_LEAST:
            self._line(now_ns, "stop burst")
        self._count("stop frame")

    def _end_count(self, now_ns: int) -> None:
        seconds = (now_ns - self._counted_ns) / 1e9
        if seconds >= COUNT_EVERY_S:
            told = ", ".join(f"{count} {kind}{'s' if count != 1 else ''}" for kind, count in self._counts.items())
            if told:
                self._line(now_ns, f"in the last {seconds:.0f} s: {told}")
            self._counts = {}
            self._counted_ns = now_ns

    def _count(self, kind: str, count: int = 1) -> None:
        self._counts[kind] = self._counts.get(kind, 0) + count

    def _line(self, at_ns: int, text: str) -> None:
        self._say(f"{(at_ns - (self._first_ns or 0)) / 1e9:9.3f} s  {text}")


def _kind(frame: Frame) -> str:
    if frame.func == MOTOR:
        return "motion frame"
    if (frame.func, frame.data) in _PINGS:
        return "ping"
    return f"{NAMES.get(frame.func, f'function {frame.func}')} frame"


def _signs(speeds: Speeds) -> tuple[int, ...]:
    return tuple((speed > 0) - (speed < 0) for speed in speeds)
