"""The supervisor's own descriptor of the port: the first stop of a run, and the stop when the port owner can't."""

from __future__ import annotations

import os
import stat
import time

from failstop.board import port
from failstop.board.interface import BOARD

BURST = BOARD.burst

REOPEN_NS = 10_000_000
"""How often a lost port is looked for: half of the time within which a board that is back is stopped."""
BUSY_S = 1.0
"""How long a port that a dead run's processes are just letting go of is waited for."""
UDEV_S = 2.0
"""How long udev may take, at boot, to give a device that is there to its users."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.finder import Finder

TRIES = 3
"""A non-blocking write is refused not only for want of room but also while another process is in its own write, as the
stopper may be at the very same moment."""


class OwnPort:
    """A duplicate of the port's descriptor; -1 while the port is gone."""

    __slots__ = ("_next_ns", "fd", "since_ns")

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self.since_ns = time.monotonic_ns()
        """When it was taken over, or let go."""
        self._next_ns = 0

    @classmethod
    def open_and_stop(cls, path: str) -> OwnPort:
        """Open the port and write the burst: the first bytes of a run. Raises port.PortError."""
        start_s = time.monotonic()
        while True:
            # Looked at before it is opened: its rights may come between a refusal and a look.
            patience_s = {"busy": BUSY_S, "permission": UDEV_S if _is_new(path) else 0.0}
            try:
                own = cls(port.open_port(path, exclusive=True))
            except port.PortError as error:
                if time.monotonic() - start_s > patience_s.get(error.kind, 0.0):
                    raise
                time.sleep(0.005)
            else:
                own.burst()
                return own

    def burst(self) -> bool:
        """Write the burst. False when the kernel did not take all of it, or the port is gone."""
        if self.fd < 0:
            return False
        for _ in range(TRIES):
            try:
                return os.write(self.fd, BURST) == len(BURST)
            except BlockingIOError:
                continue
            except OSError:
                return False
        return False

    def reopen(self, finder: Finder, now_ns: int) -> bool:
        """Open a port that was lost, tried every REOPEN_NS; False when it is there already or not yet."""
        if self.fd >= 0 or now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + REOPEN_NS
        fd = finder.open(now_ns)
        if fd < 0:
            return False
        self.replace(fd)
        return True

    def replace(self, fd: int) -> None:
        """Let the old descriptor go and keep another; -1 for none."""
        if self.fd >= 0:
            port.close_port(self.fd)
        self.fd = fd
        self.since_ns = time.monotonic_ns()


def _is_new(path: str) -> bool:
    """True while a device is as the kernel has made it: udev is still to give it to its users."""
    try:
        node = os.stat(path)
    except OSError:
        return False
    return (node.st_uid, node.st_gid, stat.S_IMODE(node.st_mode)) == (0, 0, 0o600)
