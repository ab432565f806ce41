"""MotionWriter: writes motion. It also sets the board's own watchdog again, because a restart of the board undoes that
setting."""

from __future__ import annotations

from failstop.procs.context import Context
from failstop.procs.port_owner.port import OpenPort
from failstop.procs.port_owner.port_writer import PortWriter


class MotionWriter:
    """Writes motion, with the frames that must come before it, and publishes since when the wheels are told to turn."""

    def __init__(self, context: Context, wire: PortWriter, port: OpenPort) -> None:
        self._board, self._wire, self._port = context.board, wire, port
        self._since_word = context.own.word("told_ns")
        self.turning = False
        """True if motion was written and no stop since."""
        self._backlog = max((len(ping) for ping in self._board.pings), default=0)
        """How many bytes may be waiting in the port when motion is written: as many as a ping has, which takes 70 us on
        the wire."""
        self._restarts_word = context.segment("telemetry").word("restarts")
        self._restarts = self._restarts_word.get()
        self._since(0)

    def _since(self, ns: int) -> None:
        self.turning = ns > 0
        self._since_word.set(ns)

    def stopped(self) -> None:
        """Record that a stop was written."""
        if self.turning:
            self._since(0)

    def arm(self) -> bool:
        """Set the board's own watchdog, before the first motion after a stop, because the board may have restarted in
        the meantime. False if the port does not take the frame."""
        return not self._board.arming or self._wire.frame(self._board.arming)

    def write(self, frame: bytes, now_ns: int, *, first: bool) -> bool:
        """Write a motion frame. `first`: it is the first one after a stop, so arm() came before it. False if the port
        does not take it."""
        turns = frame != self._board.stop
        if not turns:
            self.stopped()
        self._port.commands(frame, now_ns)
        if not self._wire.frame(frame, self._backlog + (len(self._board.arming) if first else 0)):
            return False
        if turns and not self.turning:
            self._since(now_ns)
        return True

    def check_restart(self, now_ns: int) -> None:
        """Send a board that has restarted the same frames again as when its port was opened."""
        restarts = self._restarts_word.get()
        if restarts != self._restarts:
            self._restarts = restarts
            self._port.configure_again(now_ns)
