"""A terminal for tests: a command in a pty of its own, its screen as far as these commands use one, and a keyboard."""

from __future__ import annotations

import fcntl
import os
import re
import select
import signal
import struct
import subprocess
import termios
import time
from types import TracebackType

from tests.support.commands import FAILSTOP

WAIT_S = 15.0
_SEQUENCE = re.compile(r"\x1b\[([0-9;?<>]*)([A-Za-z])|\x1b[=>]")


class Typist:
    """A context manager; ends the command it started."""

    def __init__(
        self, words: list[str], columns: int = 80, rows: int = 24, environ: dict[str, str] | None = None
    ) -> None:
        self._words = words
        self._environ = {**os.environ, "TERM": "xterm-256color", **(environ or {})}
        self._size = (columns, rows)
        self._lines: dict[int, str] = {}
        self._row = 1
        self._rest = ""
        self.raw = ""
        """Everything that was written."""

    @classmethod
    def failstop(cls, *words: str, columns: int = 80, rows: int = 24) -> Typist:
        """`failstop WORDS` in a terminal."""
        return cls([*FAILSTOP, *words], columns, rows)

    def __enter__(self) -> Typist:
        self.master, slave = os.openpty()
        self.resize(*self._size, tell=False)
        self.modes = termios.tcgetattr(slave)

        def own_terminal() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            self._words, stdin=slave, stdout=slave, stderr=slave, env=self._environ, preexec_fn=own_terminal
        )
        self.slave = slave
        self._open = [self.master, slave]
        os.set_blocking(self.master, False)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.hang_up()

    def hang_up(self) -> None:
        """Close the terminal, as a window or a connection does. Once: its numbers may be other files' by then."""
        while self._open:
            os.close(self._open.pop())

    def resize(self, columns: int, rows: int, *, tell: bool = True) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        if tell:
            self.process.send_signal(signal.SIGWINCH)

    def type(self, data: bytes) -> int:
        """Type; returns when (CLOCK_MONOTONIC, ns)."""
        os.write(self.master, data)
        return time.monotonic_ns()

    def look(self, timeout_s: float = 0.0) -> str:
        """Take in what was written meanwhile; returns the screen."""
        while select.select([self.master], [], [], timeout_s)[0]:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                break
            if not data:
                break
            self._take(data.decode("utf-8", "replace"))
            timeout_s = 0.0
        return self.screen()

    def peek(self) -> None:
        """Take in what was written meanwhile, so that the command can go on writing."""
        self.look()

    def screen(self) -> str:
        return "\n".join(self._lines.get(row, "") for row in range(1, max(self._lines, default=0) + 1))

    def wait(self, text: str, timeout_s: float = WAIT_S) -> str:
        """Wait until this is on the screen; returns the screen."""
        until_s = time.monotonic() + timeout_s
        while text not in self.look(0.02):
            if time.monotonic() > until_s:
                raise AssertionError(f"waited {timeout_s:g} s for {text!r}; the screen:\n{self.screen()}")
        return self.screen()

    def end(self, timeout_s: float = WAIT_S) -> int:
        """Wait for the command's end; returns its exit code."""
        until_s = time.monotonic() + timeout_s
        while self.process.poll() is None:
            self.look(0.02)
            assert time.monotonic() < until_s, f"it does not end; the screen:\n{self.screen()}"
        self.look()
        code: int = self.process.returncode
        return code

    def restored(self) -> bool:
        """True when the terminal is as it was found: its modes, its cursor, its main screen."""
        shown = self.raw.rfind("\x1b[?25h") > self.raw.rfind("\x1b[?25l")
        main = self.raw.rfind("\x1b[?1049l") > self.raw.rfind("\x1b[?1049h")
        return shown and main and termios.tcgetattr(self.slave) == self.modes

    def _take(self, text: str) -> None:
        self.raw += text
        text = self._rest + text
        self._rest = ""
        at = 0
        while at < len(text):
            if text[at] != "\x1b":
                end = text.find("\x1b", at)
                end = len(text) if end < 0 else end
                self._write(text[at:end])
                at = end
                continue
            found = _SEQUENCE.match(text, at)
            if found is None:
                self._rest = text[at:]
                return
            self._control(found.group(1) or "", found.group(2) or "")
            at = found.end()

    def _write(self, text: str) -> None:
        for number, part in enumerate(text.replace("\r", "").split("\n")):
            self._row += number > 0
            self._lines[self._row] = self._lines.get(self._row, "") + part

    def _control(self, parameters: str, final: str) -> None:
        if final == "H":
            self._row = int(parameters.split(";")[0] or 1)
            if parameters:
                self._lines[self._row] = ""  # these commands always write whole lines
        elif final == "J":
            self._lines = {row: line for row, line in self._lines.items() if parameters != "2" and row < self._row}
