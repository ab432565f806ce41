"""The driver that the peers are measured with: one small process that has the port open and commands a speed.

What a user has before failstop: nothing between the program that drives and the board.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time

from failstop.board.port import open_port
from failstop.board.rrc.board import RRC_PORT
from failstop.board.rrc.codec import motor_speeds

EVERY_S = 0.02
SPEED_RPS = 0.8


def main(link: str) -> int:
    """Drive forward until killed, or until the port goes away."""
    port = open_port(link, exclusive=False, line=RRC_PORT)
    frame = motor_speeds((SPEED_RPS, SPEED_RPS, -SPEED_RPS, -SPEED_RPS), 2 * SPEED_RPS)
    while True:
        try:
            with contextlib.suppress(BlockingIOError):
                os.write(port, frame)
            with contextlib.suppress(BlockingIOError):
                while os.read(port, 4096):
                    pass
        except OSError:
            return 1
        time.sleep(EVERY_S)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
