"""MotionWriter: writes motion frames. It also sets the board's own watchdog before the first motion after a stop. After
a restart of the board it does so again, because a restart loses that setting."""

from __future__ import annotations

from failstop.procs.context import Context
from failstop.procs.port_owner.port import OpenPort
from failstop.procs.port_owner.port_writer import PortWriter


class MotionWriter:
    """Writes motion frames, with the frames that must come before them, and publishes since when the wheels are
    commanded to turn."""

    def __init__(self, context: Context, wire: PortWriter, port: OpenPort) -> None:
        self._board, self._wire, self._port = context.board, wire, port
        self._since_word = context.own.word("told_ns")
        self._armed = False
        """True if the board's own watchdog was set since the last stop."""
        self.turning = False
        """True if the last command to the wheels was to turn, and no stop was written after it."""
        self._backlog = max((len(ping) for ping in self._board.pings), default=0)
        """Motion is written only if at most this many bytes still wait in the port. This is the size of one ping, which
        takes 70 us to send."""
        self._restarts_word = context.segment("telemetry").word("restarts")
        self._restarts = self._restarts_word.get()
        self._since(0)

    def _since(self, ns: int) -> None:
        self.turning = ns > 0
        self._since_word.set(ns)

    def stopped(self) -> None:
        """Record that a stop was written."""
        self.disarm()
        if self.turning:
            self._since(0)

    def disarm(self) -> None:
        """The next motion is the first one after a stop."""
        self._armed = False

    def arm(self) -> bool:
        """Set the board's own watchdog, unless that was done since the last stop. Call it before the first motion after
        a stop, because the board may have restarted since its watchdog was last set. Returns False if the port does not
        accept the frame."""
        if not self._armed:
            self._armed = not self._board.arming or self._wire.frame(self._board.arming)
        return self._armed

    def write(self, frame: bytes, now_ns: int, *, first: bool) -> bool:
        """Write a motion frame. `first`: True for the first motion frame after a stop, which follows after arm().
        Returns False if the port does not accept the frame."""
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
        """If the board has restarted, send it the same frames again that it got when its port was opened."""
        restarts = self._restarts_word.get()
        if restarts != self._restarts:
            self._restarts = restarts
            self._port.configure_again(now_ns)
