"""Port writer: writes to the port without ever blocking and without building up a backlog."""

from __future__ import annotations

import select

from failstop.board.interface import Board
from failstop.board.stop_port import ALREADY, StopPort
from failstop.messages import box
from failstop.shm.cell import RingWriter

DRAIN_NS = 100_000_000
"""A port that holds bytes back for this long does not drain, which is a stop cause."""


class PortWriter(StopPort):
    """The port owner's writer. It writes nothing once the port is lost."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        super().__init__(fd, board, servos)
        self._box: RingWriter | None = None
        self._early: list[int] = []
        """For each early stop that the loop has not seen yet: how much of it the kernel took, or ALREADY."""
        self._handed = 0
        """Bytes handed to the kernel since it last held none."""
        self._held_since_ns = 0
        self._refused = False
        """True if the kernel has accepted nothing of the last write."""

    def _write(self, data: bytes) -> int:
        taken = super()._write(data)
        self._refused = not (taken or self.lost)
        self._handed += taken
        return taken

    def _write_early(self) -> int:
        taken = 0 if self.lost else super()._write_early()
        self._early.append(taken)
        return taken

    def heed(self) -> None:
        """Call when the loop is about to look for deaths. Between an early stop and this call nothing but a burst goes
        out, because the thread that writes a stop early has marked its lifeline before."""
        with self._writing:
            early, self._early = self._early, []
        for taken in early:
            if taken != ALREADY:
                self._note(box.WIRE_BURST, self.board.first_stop, taken)

    def _put(self, data: bytes, *, rest: bool) -> bool:
        if rest and self._early:
            return False
        whole = super()._put(data, rest=rest)
        self._note(box.WIRE_REST if rest else box.WIRE_BURST, data, len(data) - len(self.unsent))
        return whole

    def burst(self) -> bool:
        return not self.lost and super().burst()

    def flush(self) -> bool:
        return not self.lost and super().flush()

    def holds(self) -> bool:
        held = super().holds()
        if not held:
            self._handed = 0
        return held

    def keep(self, ring: RingWriter) -> None:
        """Record in the black box the burst that was just written, and everything from now on. Attaching its ring takes
        milliseconds, so the first burst does not wait for it."""
        self._box = ring
        self._note(box.WIRE_BURST, self._stop, len(self._stop) - len(self.unsent))

    def _note(self, kind: int, data: bytes, taken: int) -> None:
        if self._box and not self.lost:
            self._box.put(box.pack_wire(kind, data, taken))

    def frame(self, data: bytes, backlog: int = 0) -> bool:
        """Write one frame. Returns False, with nothing written or kept, if the kernel takes none of it, or still holds
        bytes after it was handed more than `backlog` of them here: a frame that is kept for later would be late."""
        with self._writing:
            if self.lost or self.unsent or self._early or (self.holds() and max(self._handed, 1) > backlog):
                taken = 0
            else:
                taken = self._write(data)
                self.unsent = b"" if self.lost else data[taken:] if taken else b""
                self._stop_begun = bool(self.unsent) and data in (self.board.stop, self.board.refresh)
        self._note(box.WIRE_FRAME, data, taken)
        return taken > 0 and not self.lost

    def stuck(self, now_ns: int) -> bool:
        """True when bytes have been held back for DRAIN_NS. Call once per tick."""
        if self._refused and not self.lost and select.select((), (self.fd,), (), 0)[1]:
            self._refused = False  # another thread was writing
        if self.lost or not (self.unsent or self._refused or self.holds()):
            self._held_since_ns = 0
            return False
        if not self._held_since_ns:
            self._held_since_ns = now_ns
        return now_ns - self._held_since_ns >= DRAIN_NS

    def adopt(self, fd: int) -> None:
        """Adopt a newly opened port, whose first bytes are a burst."""
        super().adopt(fd)
        self._handed = self._held_since_ns = 0
        self._refused = False
        self.burst()
