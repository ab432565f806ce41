"""Stopping: a stop that the page asks for, through the stop pipe that every local user may write."""

from __future__ import annotations

import asyncio
import fcntl
import os
import struct
import termios
import time
from collections import deque

from failstop.api.client import send_stop
from failstop.shm import bell, instance

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

WRITTEN_S = 0.3
"""How long a request is watched; the page repeats one that was not written by then."""
LOOK_S = 0.001
MOST_IDS = 64
MOST_OF_AN_ID = 32
REASON = "STOP on the page"
_INT = struct.Struct("i")


class Asked:
    """The requests of late, by the id that the page gives each: one may come by two ways, and is one stop."""

    def __init__(self) -> None:
        self._ids: deque[str] = deque(maxlen=MOST_IDS)

    def ask(self, name: str, who: str, identity: object) -> None:
        """Ask for a stop, unless that was done for this id. Raises NoService, FailstopError, and then it was not."""
        known = str(identity)[:MOST_OF_AN_ID] if identity else ""
        if known and known in self._ids:
            return
        send_stop(name, REASON, who)
        self._ids.append(known)


async def written(name: str, epoch: Callable[[], int | None]) -> bool:
    """Wait for a stop that was asked for; True once it is written to the board, by the word of the port owner, which
    reads the pipe after that. A flood of others' requests may never leave the pipe empty: then a newer epoch says as
    much."""
    before = epoch()
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
