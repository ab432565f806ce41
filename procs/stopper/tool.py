"""The stop tool: opens the port and writes the stop burst. Needs nothing running; what systemd's ExecStopPost runs."""

from __future__ import annotations

import contextlib
import os
import time

from failstop.board import port
from failstop.board.interface import BOARD
from failstop.board.port import PortError, open_port

BURST = BOARD.burst

RETRY_S = 0.02
WARN_S = 1.0
DRAIN_S = 0.1
"""The burst takes 4 ms on the wire; a port that holds bytes for this long does not drain."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


def stop_arm(path: str, servos: tuple[int, ...]) -> None:
    """The burst once more, and behind it what stops the arm: which servos it has is in a file, and no file is read
    before the wheels were told to stop. Raises PortError."""
    _write(path, BOARD.burst_with(servos))


def stop(path: str, wait: Callable[[PortError], float], say: Callable[[str], None]) -> float:
    """Write the burst; returns after how many seconds. `wait` says for how many to try, and is asked when the first try
    has failed: the answer may be in a file. Raises PortError, the last one met."""
    start_s = time.monotonic()
    wait_s = -1.0
    warned = False
    while True:
        waited_s = time.monotonic() - start_s
        try:
            _write(path)
        except PortError as error:
            wait_s = wait(error) if wait_s < 0 else wait_s
            if waited_s >= wait_s:
                raise
            if waited_s >= WARN_S and not warned:
                warned = True
                say(f"{error}; trying for {wait_s:g} s")
            time.sleep(RETRY_S)
        else:
            return waited_s


def _write(path: str, data: bytes = BURST) -> None:
    """Open without taking the port from anyone, write the whole burst, see it drained, close."""
    fd = open_port(path, exclusive=False)
    try:
        left = data
        until_s = time.monotonic() + DRAIN_S
        while True:
            with contextlib.suppress(BlockingIOError):
                left = left[os.write(fd, left) :] if left else b""
            if not left and not port.unsent_bytes(fd):
                return
            if time.monotonic() > until_s:
                raise PortError("io", f"{path} takes no bytes: use the POWER SWITCH")
            time.sleep(0.0005)
    except OSError as error:
        raise PortError("io", f"{path} went away while writing ({error.strerror})", error.errno or 0) from None
    finally:
        port.close_port(fd)
