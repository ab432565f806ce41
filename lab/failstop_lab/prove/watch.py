"""Watching a run from outside: what the board sends, when stops were written, and the pings' answers.

While a port owner lives, all of it is read from shared memory (reading only); when the service is gone, the port itself
is opened and asked; while all of it is frozen, the port owner's own descriptor is read (borrowed.py). What telemetry
makes of the bytes is not used: it is one of the processes that die here.
"""

from __future__ import annotations

import contextlib
import os
from itertools import chain
from operator import itemgetter
from struct import Struct

from failstop.api.client import attach
from failstop.board import servos
from failstop.board.handled import Handled
from failstop.board.interface import (
    BY_IMU,
    HEARD_IMU,
    HEARD_OBEYED,
    HEARD_PAD,
    HEARD_PONG,
    HEARD_SERVO,
    HEARD_WHEELS,
    Board,
)
from failstop.board.port import PortError, open_port
from failstop.board.tap import Tap
from failstop.messages import layout, records
from failstop.procs.telemetry.imu import RAD_PER_DEG
from failstop.shm.cell import RingReader
from failstop.shm.words import Word
from failstop_lab.prove import borrowed
from failstop_lab.prove.sight import SeenSample

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.interface import Value

PORT_WRITERS = (layout.PORT_OWNER, layout.SUPERVISOR, layout.STOPPER)
ASK_EVERY_NS = 100_000_000


_COMMAND_AT = 4
_ID_POSITION = Struct("<BH")
GOES_AT_ONCE_NS = 1
"""The time of a move that says none: its servo goes as fast as it can."""
Move = tuple[int, int, int, int]
"""(when it was made, servo, where to, ns that it takes)."""
Commanded = tuple[int, tuple[float, ...]]
"""(when the gate handed the frame to the port owner, each wheel's speed in it, in turns per second)."""
Reading = tuple[int, int, int]
"""(when its answer was read, servo, where it is)."""


class Watch:
    """Call look() every millisecond or so; the lists grow until forget()."""

    def __init__(self, device: str, board: Board) -> None:
        self._device = device
        self._board = board
        self._hearing = board.hearing()
        self._received: list[RingReader] = []
        self._frames: RingReader | None = None
        self._wrote: RingReader | None = None
        self._handled = Handled(board)
        self._writers: dict[str, Word] = {}
        self._last: dict[str, int] = {}
        self._tap: Tap | None = None
        self._asks = False
        self._ask_ns = 0
        # A board that says something of its wheels only when it is asked has a question for it among the others.
        self._ask_every_ns = board.ping_ns // len(board.pings) if board.ping_ns and board.pings else ASK_EVERY_NS
        self.samples: list[SeenSample] = []
        """Reports of what observes that the wheels stand: the IMU, or the board's own of its wheels."""
        self.answers: list[tuple[int, int]] = []
        """(when something was written, when what the board said proved that it had handled it)."""
        self.obeys_zeros: list[int] = []
        """When the board reported that it obeys zeros, for whatever reason."""
        self.written: list[tuple[int, str]] = []
        """(when, by whom) of every burst."""
        self.zeros: list[int] = []
        """When the gate handed a stop of its own to the port owner."""
        self.buttons: list[tuple[int, int]] = []
        """(when, which) of every gamepad frame with a button pressed."""
        self.commanded: list[Commanded] = []
        """Every motion frame that the gate handed to the port owner. It carries whole units of the board, and when it
        repeats a speed, perhaps a little less (Board.marked)."""
        self.moves: list[Move] = []
        """Every move of a servo that the gate handed to the port owner."""
        self.readings: list[Reading] = []
        """Every answer of a servo about where it is."""

    def attach(self, name: str) -> None:
        """Follow the run of this name. Raises FailstopError."""
        self.let_go()
        views = {which: attach(name, which) for which in (*PORT_WRITERS, layout.GATE, layout.TELEMETRY)}
        owner = views[layout.PORT_OWNER]
        self._received = [view.ring_reader("received") for view in (views[layout.TELEMETRY], owner)]
        self._frames = views[layout.GATE].ring_reader("frames")
        self._wrote = owner.ring_reader("wrote", from_oldest=True)
        self._handled = Handled(self._board)
        self._writers = {which: views[which].word("written_ns") for which in PORT_WRITERS}
        self._last = {which: word.get() for which, word in self._writers.items()}
        self._hearing.reset()

    def tap_port(self) -> bool:
        """Read the port itself, once the service has gone; False while it can't be opened."""
        if self._tap is None:
            try:
                fd = open_port(self._device, exclusive=False, line=self._board.port)
            except PortError:
                return False
            self._tap_into(fd, asks=bool(self._board.pings))
            self._received, self._frames = [], None
            self._writers = {}
        return True

    def borrow_port(self, pid: int) -> str:
        """Read the port beside the frozen process `pid`, which holds it, until let_go(); returns why that can't be
        done, empty if it can. It is written to only where the board says nothing of its wheels unasked."""
        try:
            self._tap_into(borrowed.port_of(pid, self._device), asks=self._board.ping_ns > 0)
        except OSError as error:
            return f"the port of the frozen service can't be read ({error.strerror}): run it as root"
        return ""

    def _tap_into(self, fd: int, *, asks: bool) -> None:
        self.let_go()
        self._asks = asks
        self._tap = Tap(fd, self._board)
        self._ask_ns = 0

    def let_go(self) -> None:
        """Close the port, if it is open here."""
        if self._tap:
            os.close(self._tap.fd)
            self._tap = None
            self._hearing.reset()

    def forget(self) -> None:
        """Begin again; what lies ahead is kept in order."""
        heard = (self.samples, self.answers, self.obeys_zeros, self.buttons, self.readings)
        for found in (*heard, self.written, self.zeros, self.moves):
            found.clear()
        del self.commanded[:-1]  # the newest is still in force

    def look(self, now_ns: int) -> None:
        """Take in what is new."""
        for which, word in self._writers.items():
            if (written_ns := word.get()) != self._last[which]:
                self._last[which] = written_ns
                self.written.append((written_ns, which))
        while self._frames and (entry := self._frames.next()):
            _, kind, body = records.FRAME.unpack(entry[2])
            if kind == records.WRITE_BURST or (kind == records.MOTION and body == self._board.stop):
                self.zeros.append(entry[1])
            if kind == records.MOTION:
                if (speeds := self._board.speeds(body)) is not None:
                    self.commanded.append((entry[1], tuple(speeds)))
            elif kind == records.ARM and self._board.arm:
                moves = self._board.arm.moves(body)
                self.moves += [(entry[1], servo, at, takes_ns or GOES_AT_ONCE_NS) for servo, at, takes_ns in moves]
        while self._wrote and (entry := self._wrote.next()):
            self._handled.wrote(*records.WROTE.unpack(entry[2]), entry[1])
        # The port owner reads while no telemetry runs: in the order of time they are what the board has sent.
        for _, t_ns, data in sorted(chain(*(iter(ring.next, None) for ring in self._received)), key=itemgetter(1)):
            for kind, said in self._hearing.feed(data):
                self._add(t_ns, kind, said)
        if self._tap:
            self._look_at_port(self._tap, now_ns)

    def _look_at_port(self, tap: Tap, now_ns: int) -> None:
        try:
            if self._asks and now_ns >= self._ask_ns:
                self._ask_ns = now_ns + self._ask_every_ns
                with contextlib.suppress(BlockingIOError):
                    tap.ping()
            for t_ns, kind, said in tap.read():
                self._add(t_ns, kind, said)
        except OSError:
            self.let_go()

    def _add(self, t_ns: int, kind: int, said: Value) -> None:
        if kind == HEARD_IMU:
            if self._board.observed_by == BY_IMU:
                self.samples.append((t_ns, said[3] * RAD_PER_DEG, said[4] * RAD_PER_DEG))
        elif kind == HEARD_WHEELS:
            if self._board.observed_by != BY_IMU:
                self.samples.append((t_ns, *said))
        elif kind == HEARD_OBEYED and not any(said):
            self.obeys_zeros.append(t_ns)
        elif kind == HEARD_PAD:
            if said[0]:
                self.buttons.append((t_ns, said[0]))
        elif kind == HEARD_SERVO:
            servo, what, value = said
            if what == servos.POSITION and value:  # 0 is what a late answer makes of the next (docs/arm.md)
                self.readings.append((t_ns, servo, value))
        if kind in (HEARD_PONG, HEARD_OBEYED) and (proved_ns := self._proves(kind, said, t_ns)):
            self.answers.append((proved_ns, t_ns))

    def _proves(self, kind: int, said: Value, t_ns: int) -> int:
        """The time of a write that the board has handled; 0: nothing new is known. On the port itself, only answers to
        this object's own questions count."""
        if self._tap and self._board.pings:
            return self._tap.answers_ns(said, t_ns) if kind == HEARD_PONG else 0
        return self._handled.heard(kind, said, t_ns, tuple(self._last.values()))
