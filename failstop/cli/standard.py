"""Standard input, output and error. This module makes sure that all three are open, and prints without ever raising an
error.

open() returns the lowest free descriptor. If standard output or error were closed, the board's port could get
descriptor 1 or 2, and all texts for people would go to the board.
"""

from __future__ import annotations

import contextlib
import os
import sys


def fill() -> None:
    """Open /dev/null for standard input, output or error if it is closed. Call this before anything else is opened.
    Never raises."""
    try:
        while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
            os.set_inheritable(fd, True)
        os.close(fd)
        for number, name in ((1, "stdout"), (2, "stderr")):
            if getattr(sys, name) is None:
                setattr(sys, name, os.fdopen(number, "w", closefd=False))
    except OSError:
        return  # /dev/null is missing, or no descriptor is left; the command still runs, because it may be a stop


def accept_any_bytes() -> None:
    """Replace bytes on standard input that are not text, for example of a terminal with another encoding. So they make
    a wrong answer, and no traceback while a wheel may be turning. Call this before anything is read. Never raises."""
    with contextlib.suppress(AttributeError, OSError, ValueError):
        sys.stdin.reconfigure(errors="replace")  # type: ignore[union-attr]


def say(text: str) -> None:
    """Print a line on standard error, wrapped at spaces on a terminal. Never raises, so that a full disk or a closed
    terminal does not end the command."""
    from failstop.supervisor.events import PREFIX, fitted

    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(fitted(f"{PREFIX}{text}", 2) + "\n")
        sys.stderr.flush()


def print_line(text: str) -> None:
    """Print a line on standard output, or on standard error if standard output can't be written. Never raises."""
    try:
        sys.stdout.write(folded(text) + "\n")
        sys.stdout.flush()
    except (OSError, ValueError):
        let_go()
        say(text)


def folded(text: str) -> str:
    """Wrap a text at spaces if standard output is a terminal."""
    from failstop.supervisor.events import fitted

    return fitted(text, 1, 2)


def let_go() -> None:
    """Drop the text that is not yet written to standard output. Otherwise Python would try again at exit, and print
    another error."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
