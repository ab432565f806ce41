"""The supervisor's own descriptor of the port: the first stop of a run, and the stop when the port owner can't."""

from __future__ import annotations

import os
import stat
import time

from failstop.board import port
from failstop.board.interface import BOARD

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.board.finder import Finder

REOPEN_NS = 10_000_000
"""How often a lost port is looked for: half of the time within which a board that is back is stopped."""
BUSY_S = 1.0
"""How long a port that a dead run's processes are just letting go of is waited for."""
DRAIN_S = 0.1
"""The burst takes 4 ms on the wire."""
UDEV_S = 2.0
"""How long udev may take, at boot, to give a device that is there to its users."""

TRIES = 3
"""A non-blocking write is refused not only for want of room but also while another process is in its own write, as the
stopper may be at the very same moment."""


class OwnPort:
    """A duplicate of the port's descriptor; -1 while the port is gone."""

    __slots__ = ("_next_ns", "_stop", "fd", "since_ns", "stopped")

    def __init__(self, fd: int, servos: tuple[int, ...] = ()) -> None:
        """`servos`: of the robot's arm, which every burst stops with the wheels; not known to a run's first burst."""
        self.fd = fd
        self._stop = BOARD.burst_with(servos)
        self.stopped = False
        """The kernel has taken the whole of the run's first burst."""
        self.since_ns = time.monotonic_ns()
        """When it was taken over, or let go."""
        self._next_ns = 0

    @classmethod
    def open_and_stop(cls, path: str, held: Callable[[], None] = lambda: None) -> OwnPort:
        """Open the port and write the burst: the first bytes of a run. While another process holds the port, `held` is
        called, and may raise. Raises port.PortError."""
        start_s = time.monotonic()
        while True:
            # Looked at before it is opened: its rights may come between a refusal and a look.
            patience_s = {"busy": BUSY_S, "permission": UDEV_S if _is_new(path) else 0.0}
            try:
                own = cls(port.open_port(path, exclusive=True))
            except port.PortError as error:
                if time.monotonic() - start_s > patience_s.get(error.kind, 0.0):
                    raise
                if error.kind == "busy":
                    held()
                time.sleep(0.005)
            else:
                own.stopped = own.burst()
                return own

    def burst(self) -> bool:
        """Write the burst. False when the kernel did not take all of it, or the port is gone."""
        if self.fd < 0:
            return False
        for _ in range(TRIES):
            try:
                return os.write(self.fd, self._stop) == len(self._stop)
            except BlockingIOError:
                continue
            except OSError:
                return False
        return False

    def drain(self) -> bool:
        """Wait until what was written has left the kernel, which drops the rest when the port is closed; False: it has
        not within DRAIN_S."""
        until_s = time.monotonic() + DRAIN_S
        try:
            while port.unsent_bytes(self.fd):
                if time.monotonic() > until_s:
                    return False
                time.sleep(0.0005)
        except OSError:
            return False
        return True

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
