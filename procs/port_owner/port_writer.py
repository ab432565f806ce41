"""Port writer: writes to the port without blocking, and without letting many bytes queue up in the kernel."""

from __future__ import annotations

import select

from failstop.board.interface import Board
from failstop.board.stop_port import ALREADY, StopPort
from failstop.messages import box
from failstop.shm.cell import RingWriter

DRAIN_NS = 100_000_000
"""How long the port may hold bytes back before it counts as not draining, and the robot is stopped."""


class PortWriter(StopPort):
    """Writes to the port for the port owner. Once the port is lost, it writes nothing."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        super().__init__(fd, board, servos)
        self._box: RingWriter | None = None
        self._early: list[int] = []
        """For each early stop that the loop has not handled yet, how many of its bytes the kernel took. A thread writes
        an early stop as soon as it notices a death. ALREADY means that a whole stop was already on the line."""
        self._handed = 0
        """How many bytes were handed to the kernel since its output buffer was last empty."""
        self._held_since_ns = 0
        self._refused = False
        """True if the kernel took nothing of the last write."""

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
        """Allow frames again after an early stop. Until then, only bursts are written. Call it just before the loop
        looks for deaths. The loop then finds the death, because the thread marks the dead process's lifeline before it
        writes an early stop."""
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
        """Record the last burst in the black box (`ring`). From now on, also record everything that is written to the
        port. Call this only after the first burst, because attaching the ring takes milliseconds."""
        self._box = ring
        self._note(box.WIRE_BURST, self._stop, len(self._stop) - len(self.unsent))

    def _note(self, kind: int, data: bytes, taken: int) -> None:
        if self._box and not self.lost:
            self._box.put(box.pack_wire(kind, data, taken))

    def frame(self, data: bytes, backlog: int = 0) -> bool:
        """Write one frame. Returns False if the port is lost or takes no byte, if an earlier write is not finished, or
        if the loop has not handled an early stop yet. Also returns False if more than `backlog` of this writer's bytes
        are still in the kernel, because the frame would arrive late behind them."""
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
        """Return True if the port has held bytes back for DRAIN_NS. Call it once per tick."""
        if self._refused and not self.lost and select.select((), (self.fd,), (), 0)[1]:
            self._refused = False  # the last write failed only because another thread was writing
        if self.lost or not (self.unsent or self._refused or self.holds()):
            self._held_since_ns = 0
            return False
        if not self._held_since_ns:
            self._held_since_ns = now_ns
        return now_ns - self._held_since_ns >= DRAIN_NS

    def adopt(self, fd: int) -> None:
        """Adopt a newly opened port, and write a burst to it first."""
        super().adopt(fd)
        self._handed = self._held_since_ns = 0
        self._refused = False
        self.burst()
