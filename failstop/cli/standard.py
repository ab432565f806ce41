"""Standard input, output and error: made to be there, for a program that was started without them, and in nobody's way.

A descriptor from 0 to 2 that is closed is the number that the next open() returns. Were that the board's port, every
line for people would go to the board.
"""

from __future__ import annotations

import contextlib
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


def say(text: str) -> None:
    """One line on stderr, broken at words on a terminal. Never raises: that people can't be told (a full disk, a
    terminal that has gone) is no reason not to do what they asked for."""
    from failstop.supervisor.events import PREFIX, fitted

    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(fitted(f"{PREFIX}{text}", 2) + "\n")
        sys.stderr.flush()


def print_line(text: str) -> None:
    """One line on stdout, of something that was done; on stderr if stdout does not take it. Never raises."""
    from failstop.supervisor.events import fitted

    try:
        sys.stdout.write(fitted(text, 1, 2) + "\n")
        sys.stdout.flush()
    except (OSError, ValueError):
        let_go()
        say(text)


def let_go() -> None:
    """Drop the bytes that stdout still holds; else the interpreter would try again at its end, and tell of it."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
