"""Terminal: the alternate screen, the keyboard and the signals of a live command; given back as it was found."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import tty

from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.cli.screen.painter import Painter

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType, TracebackType
    from typing import Any

    from failstop.cli.style import Line

IN = 0
OUT = 1
ENTER = "\x1b[?1049h\x1b[?25l\x1b[H\x1b[2J"
LEAVE = "\x1b[0m\x1b[?25h\x1b[?1049l"
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
MOST_BYTES = 4096


class Terminal:
    """A context manager. Signals only set fields here and end a wait(); whoever waits acts on them."""

    def __init__(self, *, on: str = "", off: str = "") -> None:
        """`on` and `off`: sequences for more modes of the terminal, written after entering and before leaving.
        Raises FailstopError when standard output is no terminal."""
        if not os.isatty(OUT):
            raise FailstopError("this needs a terminal; `failstop status --json` is for programs")
        self._on = ENTER + on
        self._off = off + LEAVE
        self._painter = Painter()
        self._keyboard = os.isatty(IN)
        self._saved: list[Any] | None = None
        self._handlers: dict[int, Any] = {}
        self._pipe = (-1, -1)
        self.ended = 0
        """The signal that asks to end; 0: none does."""
        self.stopped = False
        """Ctrl-Z was pressed: call suspend()."""
        self.columns = self.rows = 0

    def __enter__(self) -> Terminal:
        self._pipe = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
        signal.set_wakeup_fd(self._pipe[1], warn_on_full_buffer=False)
        for number in (*ENDS, signal.SIGTSTP, signal.SIGCONT, signal.SIGWINCH):
            self._handlers[number] = signal.signal(number, self._note)
        self._enter()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._leave()
        signal.set_wakeup_fd(-1)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        for fd in self._pipe:
            os.close(fd)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if number in ENDS:
            self.ended = self.ended or number
        elif number == signal.SIGTSTP:
            self.stopped = True
        else:
            self._painter.forget()
            self._measure()

    def _measure(self) -> None:
        try:
            size = os.get_terminal_size(OUT)
        except OSError:
            return
        self.columns = max(style.LEAST_COLUMNS, size.columns or style.NO_TERMINAL_COLUMNS)
        self.rows = max(2, size.lines or 24)

    def _enter(self) -> None:
        if self._keyboard:
            with contextlib.suppress(termios.error):
                self._saved = termios.tcgetattr(IN)
                tty.setcbreak(IN, termios.TCSANOW)
        self._measure()
        self._painter.forget()
        self.write(self._on)

    def _leave(self) -> None:
        """Best effort: the terminal may have gone."""
        with contextlib.suppress(OSError):
            self.write(self._off)
        if self._saved is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(IN, termios.TCSAFLUSH, self._saved)

    def suspend(self) -> None:
        """Give the terminal back, stop this process as Ctrl-Z does, and go on here when it is continued."""
        self._leave()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, self._note)
        self.stopped = False
        self._enter()
        self.drop_typed()

    def write(self, text: str) -> None:
        """Write to the terminal; one that has gone ends this as a hang-up does."""
        data = text.encode(sys.stdout.encoding or "ascii", "replace")
        try:
            while data:
                data = data[os.write(OUT, data) :]
        except OSError:
            self.ended = self.ended or signal.SIGHUP

    def draw(self, lines: list[Line]) -> None:
        """Show these lines, cut to the screen's size. A terminal that takes nothing now is passed over."""
        if not select.select((), (OUT,), (), 0)[1]:
            self._painter.forget()
            return
        shown = [style.painted(line, self.columns) for line in lines[: self.rows]]
        if text := self._painter.update(shown):
            self.write(text)

    def wait(self, timeout_s: float) -> bytes:
        """What was typed; empty when nothing was until the time is over or a signal came."""
        fds = [self._pipe[0], *([IN] if self._keyboard else [])]
        ready = select.select(fds, (), (), max(0.0, timeout_s))[0]
        if self._pipe[0] in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._pipe[0], MOST_BYTES)
        if IN not in ready:
            return b""
        try:
            typed = os.read(IN, MOST_BYTES)
        except OSError:
            typed = b""
        if not typed:
            self.ended = self.ended or signal.SIGHUP
        return typed

    def drop_typed(self) -> None:
        """Forget what was typed and not read yet."""
        if self._keyboard:
            with contextlib.suppress(termios.error):
                termios.tcflush(IN, termios.TCIFLUSH)
