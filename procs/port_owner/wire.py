"""Wire: writing to the port without ever blocking and without ever building up a backlog."""

from __future__ import annotations

import os
import select

from failstop.board import port
from failstop.board.interface import BOARD
from failstop.shm import box

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.ring import RingWriter

BURST = BOARD.burst

DRAIN_NS = 100_000_000
"""A port that holds bytes back for this long does not drain: a stop cause."""


class Wire:
    """The open port. `lost` turns true when the device has gone; nothing is written from then on."""

    __slots__ = ("_box", "_handed", "_held_since_ns", "_refused", "_stop", "fd", "lost", "unsent")

    def __init__(self, fd: int, stop: bytes = BURST) -> None:
        """`stop`: the burst, and what stops the robot's arm behind it."""
        self._box: RingWriter | None = None
        self._stop = stop
        self.fd = fd
        self.lost = fd < 0
        self.unsent = b""
        """What the kernel did not take yet; only ever the rest of a burst or of one frame."""
        self._handed = 0
        """Bytes handed to the kernel since it last held none."""
        self._held_since_ns = 0
        self._refused = False
        """The last write was not taken at all."""

    def _write(self, data: bytes) -> int:
        try:
            taken = os.write(self.fd, data)
        except BlockingIOError:
            self._refused = True
            return 0
        except OSError:
            self.lost = True
            return len(data)
        self._refused = False
        self._handed += taken
        return taken

    def _holds(self) -> bool:
        """True while the kernel holds bytes, of whoever; a port that can't say has gone. How many is not asked: their
        unit is the driver's."""
        try:
            held = port.unsent_bytes(self.fd) > 0
        except OSError:
            self.lost = True
            held = False
        if not held:
            self._handed = 0
        return held

    def burst(self) -> None:
        """Write the stop burst, now. The rest of a cut frame is dropped for it, since the burst heals any cut; the rest
        of an earlier burst goes first."""
        if self.lost:
            return
        begun = self.unsent if self._stop.endswith(self.unsent) else b""
        data = begun + self._stop
        taken = self._write(data)
        self.unsent = data[taken:]
        self._note(box.BURST, data, taken)

    def keep(self, ring: RingWriter) -> None:
        """Tell the black box of the burst that was just written, and of everything from now on. Attaching its ring
        takes milliseconds, so the first burst does not wait for it."""
        self._box = ring
        self._note(box.BURST, self._stop, len(self._stop) - len(self.unsent))

    def _note(self, kind: int, data: bytes, taken: int) -> None:
        if self._box and not self.lost:
            self._box.put(box.pack_wire(kind, data, taken))

    def frame(self, data: bytes, backlog: int = 0) -> bool:
        """Write one frame. False, with nothing of it written or kept, when the kernel holds bytes and was handed more
        than `backlog` of them here, or takes none: what is kept for later would be late."""
        if self.lost or self.unsent or (self._holds() and max(self._handed, 1) > backlog):
            self._note(box.FRAME, data, 0)
            return False
        taken = self._write(data)
        self._note(box.FRAME, data, taken)
        if self.lost or not taken:
            return False
        self.unsent = data[taken:]
        return True

    def flush(self) -> None:
        """Go on with what the kernel did not take."""
        if self.unsent and not self.lost:
            taken = self._write(self.unsent)
            self._note(box.REST, self.unsent, taken)
            self.unsent = self.unsent[taken:]

    def stuck(self, now_ns: int) -> bool:
        """True when bytes have been held back for DRAIN_NS; asked once a tick."""
        if self._refused and not self.lost and self._has_room():
            self._refused = False  # somebody else was in a write of theirs
        if self.lost or not (self.unsent or self._refused or self._holds()):
            self._held_since_ns = 0
            return False
        if not self._held_since_ns:
            self._held_since_ns = now_ns
        return now_ns - self._held_since_ns >= DRAIN_NS

    def _has_room(self) -> bool:
        return bool(select.select((), (self.fd,), (), 0)[1])

    def read(self) -> bytes:
        """What the board sent; empty when nothing waits."""
        try:
            data = os.read(self.fd, 4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self.lost = True
        return data

    def adopt(self, fd: int) -> None:
        """Go on with a newly opened port; the first bytes are a burst."""
        self.fd = fd
        self.lost = False
        self.unsent = b""
        self._handed = self._held_since_ns = 0
        self.burst()

    def close(self) -> None:
        """Let the port go at once: a descriptor kept open over a USB drop renumbers the device."""
        if self.fd >= 0:
            port.close_port(self.fd)
            self.fd = -1
        self.lost = True
        self.unsent = b""
