"""The open port: its loss, its replacement, and the settings that the board gets after its port was opened. It also
reads the board while telemetry does not run. port_writer.py writes the stops.

Some boards are reset when their port is opened, and hear nothing at first. Such a port counts as open only when the
board hears and has received its settings, because motion must not begin before.
"""

from __future__ import annotations

from time import monotonic_ns

from failstop.board.handled import COMMANDED
from failstop.board.port import waiting_bytes
from failstop.messages import records
from failstop.procs.context import Context
from failstop.procs.loop import EDGE, GONE, HANGUP, NEVER, READ, WRITE, Loop, Timer
from failstop.procs.port_owner.port_writer import PortWriter
from failstop.procs.schedule import Pings

AGAIN_NS = 20_000_000
"""How long to wait before the settings are sent again, if the kernel did not take all of them."""


class OpenPort:
    """Handles the open port, and publishes what other processes learn about it."""

    def __init__(self, context: Context, loop: Loop, wire: PortWriter, now_ns: int) -> None:
        own, board = context.own, context.board
        self._loop, self._wire, self._board = loop, wire, board
        self.number, self._path = context.port_number, context.settings.text("device.path")
        self._opening = board.port.opening
        self._deaf_ns = board.port.deaf_ns
        self._record = own.latest_writer("port")
        self._received = own.ring_writer("received")
        self._supervisor_bell = context.bell("supervisor_bell")
        self._watched = (-1, 0)
        self._hears = loop.timer()
        state = records.port_state(own.latest_reader("port").read(), self.number)
        self.hears_ns = now_ns if state == records.PORT_OPEN else now_ns + self._deaf_ns
        """The time from which the board can hear. Some boards hear nothing at first after their port was opened. If an
        earlier port owner has already used this port, it was not opened again, so the board hears at once."""
        self._settings_left = () if state == records.PORT_OPEN else self._opening
        """Frames that the board must still receive before the port counts as open."""
        period_ns = min(context.settings.ns("link.ping_s"), board.ping_ns or NEVER)
        due = loop.timer() if board.pings else Timer()
        self.pings = Pings(len(board.pings), period_ns, due, self.hears_ns)
        self._asked_word = own.word("asked_ns")
        self.wrote = own.ring_writer("wrote")
        """The ring that records everything that the board will answer or echo. The entry of a stop is made after the
        stop was written. Every other entry is made before its bytes are written. If the bytes never get out, the entry
        counts as lost, which does no harm. But if an entry were missing, the board's answer would seem to prove that a
        later write has arrived."""
        self._ping_backlog = 2 * len(board.burst)
        """A ping is written only if at most this many bytes are on their way to the board. This is enough to write a
        ping directly behind a stop, so the board handles it right after the stop."""

    def begin(self, now_ns: int) -> None:
        """Begin to use the port, after the first burst was written to it. The port counts as open once the board hears
        and has received its settings."""
        self._hears.set(now_ns if self._wire.lost else self.hears_ns)
        self.configure(now_ns)

    def _hear(self, now_ns: int) -> None:
        """Send the board its settings, then publish the port as open. If the kernel does not take all settings, or if a
        stop comes between them, try again later. Until then the port must not count as open, because the board's own
        watchdog may not be set."""
        if self._wire.lost or self._configured():
            self._hears.set(NEVER)
            self.publish(now_ns)
        else:
            self._hears.set(now_ns + AGAIN_NS)

    def _configured(self) -> bool:
        """Send the settings in `_settings_left`. Returns True if the kernel has taken all of them. Otherwise the next
        call sends all of them again."""
        wire = self._wire
        for frame in self._settings_left:
            if not wire.frame(frame, len(frame) * len(self._settings_left)) or wire.unsent:
                return False
        self._settings_left = ()
        return True

    def configure(self, now_ns: int) -> None:
        """Send the settings if the board hears by now. Call it once per turn."""
        if self._hears.due(now_ns):
            self._hear(now_ns)

    def configure_again(self, now_ns: int) -> None:
        """Send the board the same frames again that it got when its port was opened."""
        if self._wire.fd >= 0 and self._hears.ns == NEVER:
            self._settings_left = self._opening
            self._hears.set(now_ns)

    def publish(self, now_ns: int) -> None:
        """Publish whether the port is open or lost, with its number and path."""
        state = records.PORT_LOST if self._wire.lost else records.PORT_OPEN
        self._record.write(records.PORT.pack(self.number, now_ns, state, self._path))
        self._supervisor_bell.ring()

    def adopt(self, sent: tuple[int, int, str], now_ns: int) -> None:
        """Adopt a newly opened port that the supervisor has sent. The supervisor has already written a burst to it."""
        fd, self.number, self._path = sent
        self._wire.adopt(fd)
        self._settings_left = self._opening
        self.hears_ns = now_ns + self._deaf_ns
        self.pings.opened(self.hears_ns)

    def ask(self, now_ns: int) -> None:
        """Write the next ping if it is due, and publish the time just before the write. The board's answer proves that
        the board has handled everything that was written before this time."""
        pings = self.pings
        if not pings.due(now_ns):
            return
        asked_ns = monotonic_ns()
        if self._wire.free_ns > asked_ns:
            pings.wait(self._wire.free_ns)
            return
        if self._question(pings.index, asked_ns):
            self._asked_word.set(asked_ns)
            pings.sent(asked_ns)
        else:
            pings.failed(now_ns)

    def ask_for_a_client(self, index: int) -> None:
        """Write a ping that a client wants answered now. It must not be published as the newest ping. Otherwise a board
        that clients ping very often would never count as deaf."""
        asked_ns = monotonic_ns()
        if asked_ns >= self.hears_ns:
            self._question(index, asked_ns)

    def _question(self, index: int, asked_ns: int) -> bool:
        """Record a ping and write it. Returns False if it was not written."""
        if self._wire.lost:
            # The ping would not be written. If it were recorded, the next board's answer might be taken for its answer.
            return False
        self.wrote.put(records.WROTE.pack(index, ()), asked_ns)
        return self._wire.frame(self._board.pings[index], backlog=self._ping_backlog)

    def commands(self, frame: bytes, now_ns: int) -> None:
        """Record the command in `frame`, if the board reports which command it obeys. `frame`: a motion frame that is
        about to be written, or a stop that was written."""
        if (speeds := self._board.commanded(frame)) is not None:
            self.wrote.put(records.WROTE.pack(COMMANDED, tuple(speeds)), now_ns)

    def serve(self, ready: dict[int, int]) -> None:
        """Read what the board has sent, write what the kernel did not take earlier, and notice if the port is gone."""
        wire = self._wire
        found = ready.get(wire.fd, 0)
        if found & WRITE:
            wire.flush()
        data = waiting_bytes(wire.fd) if found & READ else b""
        self._received.put_all(data or b"")
        wire.lost |= bool(found & GONE) or data is None

    def watch(self, *, heard: bool) -> None:
        """Watch the port for its loss. Also watch for room to write if bytes wait to be written, and for the board's
        bytes if telemetry does not read them (`heard` is False).

        The board's bytes are watched with EDGE, unless bytes wait to be written. Without EDGE, the kernel looks for
        more bytes at each wait, in a worker of ordinary priority (n_tty_poll). The port owner would sleep until that
        worker has run, and notice stops late on a busy machine.
        """
        fd, bytes_too = self._wire.fd, HANGUP if heard else READ | EDGE
        wanted = (fd, bytes_too & ~EDGE | WRITE if self._wire.unsent else bytes_too)
        if fd >= 0 and wanted != self._watched:
            self._loop.watch(*wanted)
        self._watched = wanted

    def lose(self) -> None:
        """Stop watching the port, and close it."""
        if self._watched[0] == self._wire.fd:
            self._loop.forget(self._wire.fd)
        self._watched = (-1, 0)
        self._hears.set(NEVER)
        self._wire.close()
