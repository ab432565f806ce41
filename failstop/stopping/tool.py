"""The stop tool: opens the port and writes the stop burst. Needs nothing running; what systemd's ExecStopPost runs."""

from __future__ import annotations

import os
import time

from failstop.board.port import PortError, open_port, unsent_bytes
from failstop.board.stop_port import StopPort

RETRY_S = 0.02
WARN_S = 1.0

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


def stop_arm(path: str, servos: tuple[int, ...]) -> None:
    """The burst once more, and behind it what stops the arm: which servos it has is in a file, and no file is read
    before the wheels were told to stop. Raises PortError."""
    _write(path, servos)


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


def _write(path: str, servos: tuple[int, ...] = ()) -> None:
    """Open without taking the port from anyone, write the whole burst, see it drained, close."""
    stop_port = StopPort(open_port(path, exclusive=False), servos, unsent_bytes)
    try:
        stop_port.burst()
        if not stop_port.drain():
            gone = f"went away while writing ({os.strerror(stop_port.errno)})"
            why = gone if stop_port.lost else "takes no bytes: use the POWER SWITCH"
            raise PortError("io", f"{path} {why}", stop_port.errno)
    finally:
        stop_port.close()
