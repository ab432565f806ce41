"""Port: reads the board's bytes from a duplicate of the port's descriptor. Telemetry never writes to the port."""

from __future__ import annotations

from failstop.board import port
from failstop.procs.context import Context
from failstop.procs.handover import Control, HeldPort
from failstop.procs.loop import EDGE, HANGUP, READ, Loop

LATE_NS = 100_000_000
"""Bytes that may have waited at the port for this long, in ns, count as old. Their time is then the earliest time at
which they can have come. With a later time, an old answer might be taken for the answer to a newer ping
(procs/schedule.py), and an old position of a stick might command motion."""

PROVED_NS = 3_000_000_000
"""How long after a stop the board's bytes may still prove something about the stop (supervisor/proof.py)."""


class HeardPort:
    """Reads the port's bytes, and notes when they came. This is the time of the read, or for old bytes (LATE_NS), the
    earliest time at which they can have come."""

    def __init__(self, context: Context, loop: Loop, now_ns: int) -> None:
        self._received = context.own.ring_writer("received")
        self._empty_ns = now_ns
        """The last time when no bytes were waiting at the port."""
        self._epoch = self._proved_ns = self.waited_ns = 0
        """`waited_ns`: how much earlier the last bytes may have come than the time that poll() gave them, in ns. It is
        0 for old bytes (LATE_NS), because poll() gave them the earliest possible time."""
        self.fd = -1
        self.adopt(context.fd("port"))
        control = Control(context.fd("control"))
        self.held = HeldPort(context, loop, control, self.adopt, READ | EDGE)
        loop.watch(control.fd, READ)

    def adopt(self, fd: int) -> None:
        """Replace the descriptor (-1 means no port). Drops the bytes that already wait at the new port, because their
        age is unknown."""
        if self.fd >= 0:
            port.close_port(self.fd)
        self.fd, self.lost = fd, False
        while self._read():
            pass

    def rest(self, now_ns: int, epoch: int, *, busy: bool) -> None:
        """Choose what wakes telemetry. New bytes wake it while `busy` is True, and for PROVED_NS after each stop. At
        all other times, only the loss of the port wakes it. `epoch`: the current epoch, which each stop raises."""
        if epoch != self._epoch:
            self._epoch, self._proved_ns = epoch, now_ns + PROVED_NS
        self.held.watch(READ | EDGE if busy or now_ns < self._proved_ns else HANGUP)

    def poll(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have come since the last call, as pairs (when they came, the bytes). Call it once per
        turn."""
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
