"""Port: reads the board's bytes from a duplicate of the port's descriptor, which telemetry never writes to."""

from __future__ import annotations

from failstop.board import port
from failstop.procs.context import Context
from failstop.procs.handover import Control, HeldPort
from failstop.procs.loop import EDGE, HANGUP, READ, Loop

LATE_NS = 100_000_000
"""Bytes that may have waited this long count as old: an old answer answers no newer ping (procs/schedule.py), and an
old stick position commands nothing."""

PROVED_NS = 3_000_000_000
"""This long after a stop nothing more will be learned about it (supervisor/proof.py)."""


class HeardPort:
    """The port's bytes, each with the time at which they had come."""

    def __init__(self, context: Context, loop: Loop, now_ns: int) -> None:
        self._received = context.own.ring_writer("received")
        self._empty_ns = now_ns
        """When the port was last seen without waiting bytes."""
        self._epoch = self._proved_ns = self.waited_ns = 0
        """`waited_ns`: how long the last bytes may have waited."""
        self.fd = -1
        self.adopt(context.fd("port"))
        control = Control(context.fd("control"))
        self.held = HeldPort(context, loop, control, self.adopt, READ | EDGE)
        loop.watch(control.fd, READ)

    def adopt(self, fd: int) -> None:
        """Replace the descriptor; -1: none. Bytes that wait in the new one are dropped, because nobody knows how old
        they are."""
        if self.fd >= 0:
            port.close_port(self.fd)
        self.fd, self.lost = fd, False
        while self._read():
            pass

    def rest(self, now_ns: int, epoch: int, *, busy: bool) -> None:
        """Let the port's bytes wake telemetry while a client is present or a stop is to be proved; else only its
        end."""
        if epoch != self._epoch:
            self._epoch, self._proved_ns = epoch, now_ns + PROVED_NS
        self.held.watch(READ | EDGE if busy or now_ns < self._proved_ns else HANGUP)

    def poll(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Once per turn: the bytes that have come since the last call, and when."""
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
