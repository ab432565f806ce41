"""StopPort: writes stops to a descriptor of the port. Every process that can stop the robot uses it, so all of them
follow the same policy.

    the kernel                then
    takes all of it           it is written
    takes none now (EAGAIN)   tried again at once: it refuses for lack of room, but also during another process's write
    takes a part, or none     not written; the rest goes first with the next burst, or with flush()
    knows no such device      not written; the port is gone
"""

from __future__ import annotations

import _thread
import os
import time

from failstop.board import port

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.interface import Board

TRIES = 3
DRAIN_S = 0.1
"""The burst takes 4 ms on the wire. If a port still holds bytes after this time, s, it does not drain."""
LOOK_S = 0.0005
ALREADY = -1
EARLY_NS = 2_000_000
"""An early stop that is whole counts as on the line for this long, because its loop is about to write the same."""


class StopPort:
    """A descriptor of the port for stops; -1: no port. `lost` becomes true when a write finds that the device is gone;
    `errno` is the reason."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        """`servos`: the ids of the robot's arm. The frames that stop them end the same write, so they follow a whole
        burst or are not written at all."""
        self.board = board
        self._stop = board.burst + (board.arm.stops(servos) if board.arm else b"")
        self.free_ns = 0
        """When the line will have been silent for as long as the board needs, as far as this process knows; 0: the
        board needs no silence."""
        self._line_ns = 0
        """Until this time the last whole stop that was written here is on the line, or the line must be silent after
        it, so another stop would garble both. 0: no such stop."""
        self.fd = fd
        self.lost = fd < 0
        self.errno = 0
        self.unsent = b""
        """Bytes of one burst or frame that the kernel has not accepted yet."""
        self._stop_begun = False
        """True if `unsent` is the rest of a stop."""
        self._writing = _thread.allocate_lock()
        """Held by the loop while it checks whether it may write, and writes; and by a thread in early_stop()."""

    def early_stop(self) -> None:
        """Write the burst as far as its first stop frame, from the thread that has learned about a death. It also wakes
        the loop, which writes the burst."""
        with self._writing:
            if self.fd >= 0:
                self._write_early()

    def _write_early(self) -> int:
        """How many bytes the kernel took; ALREADY if a whole stop is already on the line."""
        if self._on_line():
            return ALREADY
        taken = self._write(self.board.first_stop)
        if taken == len(self._stop):
            self._line_ns = max(self._line_ns, time.monotonic_ns() + EARLY_NS)
        return taken

    def burst(self) -> bool:
        """Write the stop burst now; True if the kernel has all of it.

        The rest of an earlier stop goes first. The rest of any other frame is dropped, because the burst heals any cut,
        and so is more than one burst, because stops would pile up at a port that takes nothing. If a whole stop is
        still on the line, nothing is written: on some boards a second one without a gap garbles both.
        """
        begun = self.unsent if self._stop_begun and len(self.unsent) <= len(self._stop) else b""
        with self._writing:
            if self._on_line():
                return True
            return self.fd >= 0 and self._put(begun + self._stop, rest=False)

    def repeat(self, after_ns: tuple[int, ...]) -> None:
        """Write the burst again after each of these times, and wait meanwhile. For a program without a loop."""
        begun_ns = time.monotonic_ns()
        for after in after_ns:
            time.sleep(max(0, begun_ns + after - time.monotonic_ns()) / 1e9)
            self.burst()

    def flush(self) -> bool:
        """Continue with bytes that the kernel did not take; True if nothing is left."""
        with self._writing:
            return not self.unsent or self._put(self.unsent, rest=True)

    def _on_line(self) -> bool:
        return self._line_ns > 0 and not (self.lost or self.unsent) and time.monotonic_ns() < self._line_ns

    def _put(self, data: bytes, *, rest: bool) -> bool:
        """Write as much as the kernel takes; `rest`: these bytes continue an earlier write."""
        taken = self._write(data)
        self.unsent = b"" if self.lost else data[taken:]
        if not rest:
            self._stop_begun = bool(self.unsent)
        return taken == len(data)

    def _write(self, data: bytes) -> int:
        for _ in range(TRIES):
            try:
                taken = os.write(self.fd, data)
            except BlockingIOError:
                continue
            except OSError as error:
                self.lost, self.errno = True, error.errno or 0
                return 0
            self.lost, self._line_ns = False, 0
            if idle_ns := self.board.idle_ns:
                begun_ns = max(time.monotonic_ns(), self.free_ns - idle_ns)
                end_ns = begun_ns + taken * self.board.port.byte_ns
                self.free_ns = end_ns + idle_ns
                if self.board.after_ns and taken == len(data) and data == self._stop:
                    self._line_ns = end_ns + self.board.after_ns
            return taken
        return 0

    def holds(self) -> bool:
        """True while the kernel holds bytes that any process has written. A port that can't tell is gone."""
        try:
            return self.fd >= 0 and port.unsent_bytes(self.fd) > 0
        except OSError as error:
            self.lost, self.errno = True, error.errno or 0
            return False

    def drain(self, within_s: float = DRAIN_S) -> bool:
        """Wait until all written bytes have left the kernel, which drops the rest when the port is closed. False if
        that takes longer than `within_s`, or the port is gone."""
        until_s = time.monotonic() + within_s
        while self.fd >= 0:
            if self.flush() and not self.holds() and not self.lost:
                return True
            if self.lost or time.monotonic() > until_s:
                return False
            time.sleep(LOOK_S)
        return False

    def adopt(self, fd: int) -> None:
        """Close the old descriptor at once and keep another; -1 for none. A descriptor that is kept open over a USB
        drop renumbers the device."""
        with self._writing:
            old, self.fd = self.fd, fd
            self.lost = fd < 0
            self.unsent = b""
            self._line_ns = 0
        if old >= 0:
            port.close_port(old)

    def close(self) -> None:
        """Close the descriptor."""
        self.adopt(-1)
