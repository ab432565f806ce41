"""Standard input, output and error: made to be there, for a program that was started without them.

A descriptor from 0 to 2 that is closed is the number that the next open() returns. Were that the board's port, every
line for people would go to the board.
"""

from __future__ import annotations

import os
import sys


def fill() -> None:
    """Call before anything is opened: what is closed of the three becomes /dev/null. Never raises."""
    try:
        while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
            os.set_inheritable(fd, True)
        os.close(fd)
        for number, name in ((1, "stdout"), (2, "stderr")):
            if getattr(sys, name) is None:
                setattr(sys, name, os.fdopen(number, "w", closefd=False))
    except OSError:
        return  # no /dev/null, or no descriptor: no reason not to stop
