"""Terminal: the full screen, the keyboard and the signals for a live command. When the command ends, the terminal looks
as before."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Any

from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.cli.style import Line

IN = 0
OUT = 1
CLEAR = "\x1b[H\x1b[2J"
ENTER = f"\x1b[?1049h\x1b[?25l\x1b[?2004h{CLEAR}"
"""Switches to the alternate screen, hides the cursor, and asks the terminal to mark pasted text."""
MOUSE = "\x1b[?1007s\x1b[?1007l\x1b[?1000h\x1b[?1006h"
"""Makes the terminal report the mouse. Otherwise many terminals send the bytes of the up and down arrows when a person
scrolls on the alternate screen, and these keys may drive the robot. tmux and some terminals do that even after ?1007l,
which is meant to switch it off. Shift with the mouse still selects text."""
NO_MOUSE = "\x1b[?1006l\x1b[?1000l\x1b[?1007h\x1b[?1007r"
"""The end of MOUSE. A terminal that has saved the mode 1007 restores it, any other one switches it on, as is usual."""
LEAVE = "\x1b[?2004l\x1b[0m\x1b[?25h\x1b[?1049l"
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
"""The signals that end the command. Ctrl-Z (SIGTSTP) ends the command instead of suspending it, because nobody would
drive or attend the robot while the command is suspended."""
MOST_BYTES = 4096


class Terminal:
    """Shows a live command on the terminal. Use it as a context manager. A signal in ENDS only sets `ended` to its
    number, and then the loop of turns() ends."""

    def __init__(self, *, mouse: bool = False) -> None:
        """`mouse`: the terminal must report the mouse, because the arrow keys do something. Raises FailstopError if
        standard output is not a terminal, or if the terminal does not understand escape sequences."""
        if not os.isatty(OUT):
            raise FailstopError("this command shows a live screen, so run it in a terminal")
        if not style.lives(os.environ, terminal=True):
            term = os.environ.get("TERM", "")
            raise FailstopError(f"this command needs a terminal that can draw a screen, but TERM is {term!r}")
        self._mouse = mouse
        self._shown: list[str] | None = None
        """The lines on the screen. None if they are not known, so that all lines must be drawn."""
        self._keyboard = os.isatty(IN)
        self._saved: list[Any] | None = None
        self._handlers: dict[int, Any] = {}
        self.ended = 0
        """The number of the signal that has asked this command to end. 0 until such a signal arrives."""
        self.columns = self.rows = 0

    def __enter__(self) -> Terminal:
        for number in (*ENDS, signal.SIGCONT, signal.SIGWINCH):
            self._handlers[number] = signal.signal(number, self._note)
        with contextlib.suppress(termios.error):
            self._saved = termios.tcgetattr(IN)
            tty.setcbreak(IN)  # drops keys that were typed before
        self._measure()
        self.write(f"{ENTER}{MOUSE if self._mouse else ''}")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.write(f"{NO_MOUSE if self._mouse else ''}{LEAVE}")
        if self._saved is not None:
            with contextlib.suppress(termios.error):  # the terminal may be closed
                termios.tcsetattr(IN, termios.TCSAFLUSH, self._saved)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if number in ENDS:
            self.ended = self.ended or number
        else:
            self._measure()

    def _measure(self) -> None:
        self._shown = None
        with contextlib.suppress(OSError):
            size = os.get_terminal_size(OUT)
            self.columns = max(style.LEAST_COLUMNS, size.columns or style.NO_TERMINAL_COLUMNS)
            self.rows = max(2, size.lines or 24)

    def write(self, text: str) -> None:
        """Write a text to the terminal. If that fails, the terminal was closed. The command then ends as after
        SIGHUP."""
        data = text.encode(sys.stdout.encoding or "ascii", "replace")
        try:
            while data:
                data = data[os.write(OUT, data) :]
        except OSError:
            self.ended = self.ended or signal.SIGHUP

    def writable(self) -> bool:
        """Return True if the terminal can take bytes now, without a delay."""
        return bool(select.select((), (OUT,), (), 0)[1])

    def draw(self, lines: list[Line]) -> None:
        """Show these lines, as many as fit. Writes only changed lines, and nothing if the terminal can't take bytes
        now."""
        if not self.writable():
            self._shown = None
            return
        rows = [style.painted(line, self.columns) for line in style.fit(lines, self.rows)]
        before, self._shown = self._shown, rows
        if text := difference(before, rows):
            self.write(text)

    def wait(self, timeout_s: float) -> bytes:
        """Wait for keys, and return their bytes. Empty if nothing was typed within `timeout_s`. If the terminal was
        closed, the command ends as after SIGHUP."""
        if not select.select([IN] if self._keyboard else [], (), (), max(0.0, timeout_s))[0]:
            return b""
        try:
            typed = os.read(IN, MOST_BYTES)
        except OSError:
            typed = b""
        if not typed:
            self.ended = self.ended or signal.SIGHUP
        return typed

    def turns(self, period_s: float) -> Iterator[tuple[bytes, float | None]]:
        """Run the loop of a live command until a signal ends it. Each pass yields the typed bytes and the present time
        (time.monotonic()). The time is None if the screen need not be drawn again."""
        next_s = time.monotonic()
        while not self.ended:
            typed = self.wait(next_s - time.monotonic())
            now_s = time.monotonic()
            due = now_s >= next_s
            if due:
                next_s = max(next_s + period_s, now_s + period_s / 2)
            yield typed, now_s if due else None


def difference(before: list[str] | None, rows: list[str]) -> str:
    """Return the text that makes the terminal show `rows`, which must fit on the screen. `before`: the rows that it
    shows at present, or None if they are not known."""
    shown = before or []
    parts = [CLEAR] if before is None else []
    for number, row in enumerate(rows):
        if number >= len(shown) or shown[number] != row:
            parts.append(f"\x1b[{number + 1};1H{row}\x1b[K")
    if len(rows) < len(shown):
        parts.append(f"\x1b[{len(rows) + 1};1H\x1b[J")
    return "".join(parts)
