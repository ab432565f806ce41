"""StopPort: writes stops to the port. Every process that can stop the robot uses this class, so all processes write a
stop in the same way.

    if the kernel                  then
    takes the whole stop           the stop is written
    takes nothing (EAGAIN)         the stop is tried again at once: the kernel lacks room, or another process is writing
    still takes nothing, or has    the next burst() or flush() first writes the rest of this stop
      taken only a part of it
    knows no such device           the stop is not written, and `lost` becomes true
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
"""How long drain() waits for the port to send all its bytes, in s. A burst takes only 4 ms on the line. If a port still
holds bytes after this time, it is not sending."""
LOOK_S = 0.0005
ALREADY = -1
EARLY_NS = 2_000_000
"""If early_stop() has written a whole stop, burst() writes nothing for this long, in ns. The thread of early_stop()
wakes the loop of its process, which would otherwise write the same stop again at once."""


class StopPort:
    """Writes stops to an open port. `fd` is its descriptor, or -1 for no port. `lost` becomes true when a write finds
    that the device is gone, and `errno` is then the reason."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        """`servos` are the ids of the arm's servos. Their stop frames follow the burst in the same write, so the kernel
        takes them only after the whole burst."""
        self.board = board
        self._stop = board.burst + (board.arm.stops(servos) if board.arm else b"")
        self.free_ns = 0
        """The time from which the line has been silent long enough for the board, in ns. What other processes have
        written is not counted. 0 if the board needs no silence."""
        self._line_ns = 0
        """The earliest time for this process's next stop, in ns. 0 if a stop may be written at once. On some boards, a
        second stop before this time would garble both stops: the first one is still on the line, or the line must be
        silent after it. The time is also set when early_stop() has written a whole stop (EARLY_NS)."""
        self.fd = fd
        self.lost = fd < 0
        self.errno = 0
        self.unsent = b""
        """The bytes of one burst or frame that the kernel has not accepted yet."""
        self._stop_begun = False
        """True if `unsent` is the rest of a stop."""
        self._writing = _thread.allocate_lock()
        """A lock that a thread holds while it checks whether it may write, and while it writes. Both the loop and the
        thread that calls early_stop() take it."""

    def early_stop(self) -> None:
        """Write the burst up to the end of its first stop frame. The thread that notices a death calls this, because it
        is faster than the loop. The thread also wakes the loop. The loop then writes the whole burst, unless the early
        stop was already a whole stop."""
        with self._writing:
            if self.fd >= 0:
                self._write_early()

    def _write_early(self) -> int:
        """Write the early stop. Returns how many bytes the kernel took, or ALREADY if a whole stop is already on the
        line."""
        if self._on_line():
            return ALREADY
        taken = self._write(self.board.first_stop)
        if taken == len(self._stop):
            self._line_ns = max(self._line_ns, time.monotonic_ns() + EARLY_NS)
        return taken

    def burst(self) -> bool:
        """Write the stop burst now. Returns True if the kernel has taken all of it.

        While a whole stop is still on the line, nothing is written and the result is True, because on some boards a
        second stop without a gap garbles both. If the kernel has taken only a part of the last frame, the rest is
        dropped, because a burst works after any cut. The rest of a stop is written before the new stop. If that rest is
        longer than one burst, it is dropped too. Otherwise stops would pile up at a port that takes nothing.
        """
        begun = self.unsent if self._stop_begun and len(self.unsent) <= len(self._stop) else b""
        with self._writing:
            if self._on_line():
                return True
            return self.fd >= 0 and self._put(begun + self._stop, rest=False)

    def repeat(self, after_ns: tuple[int, ...]) -> None:
        """Write the burst again at each of these times, in ns from now, and wait in between. This is for a program
        without a loop."""
        begun_ns = time.monotonic_ns()
        for after in after_ns:
            time.sleep(max(0, begun_ns + after - time.monotonic_ns()) / 1e9)
            self.burst()

    def flush(self) -> bool:
        """Write more of the bytes that the kernel has not taken yet. Returns True if none are left."""
        with self._writing:
            return not self.unsent or self._put(self.unsent, rest=True)

    def _on_line(self) -> bool:
        return self._line_ns > 0 and not (self.lost or self.unsent) and time.monotonic_ns() < self._line_ns

    def _put(self, data: bytes, *, rest: bool) -> bool:
        """Write as much as the kernel takes. Returns True if it took everything. Set `rest` if these bytes continue an
        earlier write."""
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
        """True while the kernel still holds bytes for the port, from this or any other process. If the kernel can't
        say, the device is gone, and `lost` becomes true."""
        try:
            return self.fd >= 0 and port.unsent_bytes(self.fd) > 0
        except OSError as error:
            self.lost, self.errno = True, error.errno or 0
            return False

    def drain(self, within_s: float = DRAIN_S) -> bool:
        """Wait until all written bytes have left the kernel. Call this before close(), which may drop the bytes that
        are left. Returns False if it takes longer than `within_s`, or if the port is gone."""
        until_s = time.monotonic() + within_s
        while self.fd >= 0:
            if self.flush() and not self.holds() and not self.lost:
                return True
            if self.lost or time.monotonic() > until_s:
                return False
            time.sleep(LOOK_S)
        return False

    def adopt(self, fd: int) -> None:
        """Use another descriptor, or none if `fd` is -1, and close the old one. While a descriptor of an unplugged USB
        device is open, the device comes back with another number, such as ttyACM1 after ttyACM0."""
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
