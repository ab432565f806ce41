"""Port: what the board sends, read from a duplicate of the port's descriptor, which telemetry never writes to."""

from __future__ import annotations

from failstop.board import port
from failstop.procs.context import Context
from failstop.procs.handover import Control, HeldPort
from failstop.procs.loop import EDGE, HANGUP, READ, Loop

LATE_NS = 100_000_000
"""Bytes that may have waited for as long as this count as older, whatever they are: an old answer is none to a newer
ping (procs/schedule.py), an old stick of the gamepad commands nothing."""

PROVED_NS = 3_000_000_000
"""So long after a stop nothing is to be learned of it any more (supervisor/proof.py)."""


class HeardPort:
    """Its bytes, each with the time at which it had come."""

    def __init__(self, context: Context, loop: Loop, now_ns: int) -> None:
        self._received = context.own.ring_writer("received")
        self._empty_ns = now_ns
        """When nothing waited in it for the last time."""
        self._epoch = self._proved_ns = self.waited_ns = 0
        """The time within which came what was taken last."""
        self.fd = -1
        self.adopt(context.fd("port"))
        control = Control(context.fd("control"))
        self.held = HeldPort(context, loop, control, self.adopt, READ | EDGE)
        loop.watch(control.fd, READ)

    def adopt(self, fd: int) -> None:
        """Let it go for another, -1 for none. What waits there is dropped: nobody knows since when."""
        if self.fd >= 0:
            port.close_port(self.fd)
        self.fd, self.lost = fd, False
        while self._read():
            pass

    def rest(self, now_ns: int, epoch: int, *, busy: bool) -> None:
        """Have its bytes wake telemetry while somebody is there, or a stop is to be proved; else its end alone."""
        if epoch != self._epoch:
            self._epoch, self._proved_ns = epoch, now_ns + PROVED_NS
        self.held.watch(READ | EDGE if busy or now_ns < self._proved_ns else HANGUP)

    def take(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Once a turn: what has come since the last, and when."""
        waited_ns = now_ns - self._empty_ns
        came_ns, self.waited_ns = (now_ns, waited_ns) if waited_ns < LATE_NS else (self._empty_ns, 0)
        found = []
        while data := self._read():
            found.append((came_ns, data))
            self._received.put_all(data, came_ns)
            if len(data) < port.READ_BYTES:
                break
        self._empty_ns = now_ns
        return found

    def _read(self) -> bytes:
        data = port.waiting_bytes(self.fd) if self.fd >= 0 and not self.lost else b""
        self.lost |= data is None
        return data or b""
