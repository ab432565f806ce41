"""Standard input, output and error: open them if the program was started without them, and write to them without ever
failing.

open() returns the lowest free descriptor. If 1 or 2 were free and the board's port got that number, every line for
people would go to the board.
"""

from __future__ import annotations

import contextlib
import os
import sys


def fill() -> None:
    """Open /dev/null in place of each of the three that is closed. Call it before anything else is opened. Never
    raises."""
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
    """Write one line to stderr; on a terminal it is wrapped at words. Never raises, because a full disk or a closed
    terminal is no reason not to do what people asked for."""
    from failstop.supervisor.events import PREFIX, fitted

    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(fitted(f"{PREFIX}{text}", 2) + "\n")
        sys.stderr.flush()


def print_line(text: str) -> None:
    """Write one line about something that was done to stdout, or to stderr if stdout can't be written. Never raises."""
    try:
        sys.stdout.write(folded(text) + "\n")
        sys.stdout.flush()
    except (OSError, ValueError):
        let_go()
        say(text)


def folded(text: str) -> str:
    """The text as it should be written to stdout: on a terminal, wrapped at words."""
    from failstop.supervisor.events import fitted

    return fitted(text, 1, 2)


def let_go() -> None:
    """Drop the bytes that stdout still holds. Otherwise the interpreter would try to write them when it exits, and
    print an error."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
