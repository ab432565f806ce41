"""Driver: the throw-away process of a probe, which drives as vendors' drivers do: one frame again and again, no watch.

`python -m failstop_lab.probe.driver PORT BAUD DTR RTS HEX PERIOD_S`. SIGUSR1: it falls silent and goes on living;
SIGUSR2: it closes the port and goes on living. It begins at a line on standard input, by which its watcher knows of it,
and ends where that never comes; it prints a line when the first frame is out.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from types import FrameType

from failstop.board.port import open_port
from failstop.board.wire import Port


def main(words: list[str]) -> None:
    """Until it is killed."""
    path, baud, dtr, rts, frame, period_s = words
    if not sys.stdin.readline():
        return
    line = Port(baud=int(baud), dtr=dtr == "1", rts=rts == "1", deaf_ns=0, opening=())
    fd = open_port(path, exclusive=False, line=line)
    data, drives = bytes.fromhex(frame), True

    def silent(_number: int, _frame: FrameType | None) -> None:
        nonlocal drives
        drives = False

    def close(_number: int, _frame: FrameType | None) -> None:
        nonlocal drives
        if drives:
            drives = False
            os.close(fd)

    signal.signal(signal.SIGUSR1, silent)
    signal.signal(signal.SIGUSR2, close)
    told = False
    while True:
        if drives:
            with contextlib.suppress(OSError):
                os.write(fd, data)
            if not told:
                print("drives", flush=True)
                told = True
        time.sleep(float(period_s))


if __name__ == "__main__":
    main(sys.argv[1:])
