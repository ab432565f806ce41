"""StopPort: a descriptor of the port that can be burst on. Whoever can stop writes through one: one policy for all.

the kernel                what follows
takes all of it           it is written
takes none now (EAGAIN)   tried again at once: it refuses for want of room, but also while another is in its write
takes a part, or none     not written; the rest goes first with the next burst, or with flush()
knows no such device      not written; the port has gone
"""

from __future__ import annotations

import _thread
import os
import time

from failstop.board import port
from failstop.board.interface import BOARD

TRIES = 3
DRAIN_S = 0.1
"""The burst takes 4 ms on the wire; a port that holds bytes for this long does not drain."""
LOOK_S = 0.0005


class StopPort:
    """-1: no port. `lost` turns true when a write finds that the device has gone, for the reason `errno`."""

    __slots__ = ("_stop", "_writing", "errno", "fd", "lost", "unsent")

    def __init__(self, fd: int, servos: tuple[int, ...] = ()) -> None:
        """`servos`: of the robot's arm: what stops them is the end of the same write, so that it comes behind a whole
        burst or not at all."""
        self._stop = BOARD.burst_with(servos)
        self.fd = fd
        self.lost = fd < 0
        self.errno = 0
        self.unsent = b""
        """Bytes of one burst or frame that the kernel has not accepted yet."""
        self._writing = _thread.allocate_lock()
        """Held by the loop while it looks whether it may write, and writes; and by a thread in early_stop()."""

    def early_stop(self) -> None:
        """Write the burst as far as its first stop frame, from the thread that has learned of a death. The loop, which
        is woken then, writes the burst."""
        with self._writing:
            if self.fd >= 0:
                self._write_early()

    def _write_early(self) -> int:
        return self._write(BOARD.first_stop)

    def burst(self) -> bool:
        """Write the stop burst, now; True when the kernel has all of it. The rest of a cut frame is dropped for it,
        since the burst heals any cut; the rest of an earlier burst goes first."""
        begun = self.unsent if self._stop.endswith(self.unsent) else b""
        with self._writing:
            return self.fd >= 0 and self._put(begun + self._stop, rest=False)

    def flush(self) -> bool:
        """Go on with what the kernel did not take; True when nothing is left."""
        with self._writing:
            return not self.unsent or self._put(self.unsent, rest=True)

    def _put(self, data: bytes, *, rest: bool) -> bool:
        """Write what can be; `rest`: of what was begun before."""
        taken = self._write(data)
        self.unsent = b"" if self.lost else data[taken:]
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
            self.lost = False
            return taken
        return 0

    def drain(self, within_s: float = DRAIN_S) -> bool:
        """Wait until what was written has left the kernel, which drops the rest when the port is closed; False: it has
        not within that time, or the port has gone."""
        until_s = time.monotonic() + within_s
        while self.fd >= 0:
            try:
                if self.flush() and not port.unsent_bytes(self.fd):
                    return True
            except OSError as error:
                self.lost, self.errno = True, error.errno or 0
            if self.lost or time.monotonic() > until_s:
                return False
            time.sleep(LOOK_S)
        return False

    def adopt(self, fd: int) -> None:
        """Let the old descriptor go at once and keep another, -1 for none. One that is kept open over a USB drop
        renumbers the device."""
        with self._writing:
            old, self.fd = self.fd, fd
            self.lost = fd < 0
            self.unsent = b""
        if old >= 0:
            port.close_port(old)

    def close(self) -> None:
        """Let it go."""
        self.adopt(-1)
