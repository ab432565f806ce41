"""The supervisor's own descriptor of the port: the first stop of a run, and the stop when the port owner can't."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable

from failstop.board import port
from failstop.board.stop_port import StopPort

BUSY_S = 1.0
"""How long a port that a dead run's processes are just letting go of is waited for."""
UDEV_S = 2.0
"""How long udev may take, at boot, to give a device that is there to its users."""


class OwnPort(StopPort):
    """A duplicate of the port's descriptor; -1 while the port is gone."""

    __slots__ = ("number", "stopped")

    def __init__(self, fd: int, servos: tuple[int, ...] = ()) -> None:
        """`servos`: of the robot's arm, which is stopped with the wheels; not known to a run's first burst."""
        super().__init__(fd, servos)
        self.stopped = False
        """The kernel has taken the whole of the run's first burst."""
        self.number = 1
        """How many ports this run has had: the name of this one among those who share it."""

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

    def adopt(self, fd: int) -> None:
        super().adopt(fd)
        self.number += fd >= 0

    def holds(self) -> bool:
        """True while the kernel holds bytes that it has taken and not passed on, of whoever; False too where the port
        can't say."""
        try:
            return self.fd >= 0 and port.unsent_bytes(self.fd) > 0
        except OSError:
            return False


def _is_new(path: str) -> bool:
    """True while a device is as the kernel has made it: udev is still to give it to its users."""
    try:
        node = os.stat(path)
    except OSError:
        return False
    return (node.st_uid, node.st_gid, stat.S_IMODE(node.st_mode)) == (0, 0, 0o600)
