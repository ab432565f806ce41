"""Standard input, output and error. This module makes sure that all three are open, and prints without ever raising an
error.

open() returns the lowest free descriptor. If standard output or error were closed, the board's port could get
descriptor 1 or 2, and all texts for people would go to the board.
"""

from __future__ import annotations

import _thread
import contextlib
import os
import sys
from _queue import SimpleQueue

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


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


class Printer:
    """Prints texts in their order, in a thread of its own. Until done(), nobody has to wait for a paused terminal, or
    for a pipe that nobody reads."""

    def __init__(self) -> None:
        self._texts: SimpleQueue[tuple[Callable[[str], None], str] | None] = SimpleQueue()
        self._ended: _thread.LockType | None = None
        """Locked while the thread runs. None before the first text."""

    def put(self, prints: Callable[[str], None], text: str) -> None:
        """Have `prints(text)` called soon."""
        if self._ended is None:
            ended = _thread.allocate_lock()
            ended.acquire()
            try:
                _thread.start_new_thread(self._print, (ended,))
            except RuntimeError:  # no thread can be started
                prints(text)
                return
            self._ended = ended
        self._texts.put((prints, text))

    def done(self) -> None:
        """Wait until everything is printed."""
        if self._ended:
            self._texts.put(None)
            self._ended.acquire()

    def _print(self, ended: _thread.LockType) -> None:
        while (found := self._texts.get()) is not None:
            prints, text = found
            prints(text)
        ended.release()


_printer: Printer | None = None


@contextlib.contextmanager
def never_waiting() -> Iterator[None]:
    """Within this context, say() and print_line() return at once, so that a stop does not wait for its texts. Its end
    waits until they are printed."""
    global _printer
    _printer = Printer()
    try:
        yield
    finally:
        printer, _printer = _printer, None
        printer.done()


def say(text: str) -> None:
    """Print a line on standard error, wrapped at spaces on a terminal. Never raises, so that a full disk or a closed
    terminal does not end the command."""
    _by_printer(_say, text)


def _by_printer(prints: Callable[[str], None], text: str) -> None:
    if _printer:
        _printer.put(prints, text)
    else:
        prints(text)


def _say(text: str) -> None:
    from failstop.supervisor.events import PREFIX, fitted

    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(fitted(f"{PREFIX}{text}", 2) + "\n")
        sys.stderr.flush()


def print_line(text: str) -> None:
    """Print a line on standard output, or on standard error if standard output can't be written. Never raises."""
    _by_printer(_print_line, text)


def _print_line(text: str) -> None:
    try:
        sys.stdout.write(folded(text) + "\n")
        sys.stdout.flush()
    except (OSError, ValueError):
        let_go()
        _say(text)


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
