"""What the simulated board's tests share."""

from __future__ import annotations

import time
from collections.abc import Callable

from failstop.board import codec

FORWARD = (0.796, 0.796, -0.796, -0.796)
DRIVE = codec.motor_speeds(FORWARD, 2.0)


def wait_until(what: str, check: Callable[[], bool], timeout_s: float = 10.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not check():
        assert time.monotonic() < end_s, f"waited {timeout_s} s for {what}"
        time.sleep(0.005)
