"""Stopping: a stop that the page asks for, through the stop pipe that every local user may write."""

from __future__ import annotations

import asyncio
import fcntl
import os
import struct
import termios
import time

from failstop.api.client import send_stop
from failstop.shm import bell, instance

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

WRITTEN_S = 0.3
"""How long a request is watched; the page repeats one that was not written by then."""
LOOK_S = 0.001
REASON = "STOP on the page"
_INT = struct.Struct("i")


async def stop(name: str, who: str, epoch: Callable[[], int | None]) -> bool:
    """Ask for a stop; True once it is written to the board, by the word of the port owner, which reads the pipe after
    that. A flood of others' requests may never leave the pipe empty: then a newer epoch says as much. Raises
    NoService, FailstopError."""
    before = epoch()
    send_stop(name, REASON, who)
    try:
        pipe = bell.open_pipe_to_write(instance.stop_path(instance.find(name)))
    except (OSError, instance.InstanceError, instance.NoService):
        return False
    try:
        until_s = time.monotonic() + WRITTEN_S
        while time.monotonic() < until_s:
            if not _waiting(pipe):
                return True
            await asyncio.sleep(LOOK_S)
        now = epoch()
        return before is not None and now is not None and now > before
    except OSError:
        return False
    finally:
        os.close(pipe)


def _waiting(pipe: int) -> int:
    """Bytes that nobody has read yet. Raises OSError."""
    found: tuple[int] = _INT.unpack(fcntl.ioctl(pipe, termios.FIONREAD, _INT.pack(0)))
    return found[0]
