"""A terminal: a command at a pseudo-terminal of its own, what it says there, and what a person types."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import re
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING

from failstop_lab.trial import TrialError

if TYPE_CHECKING:
    from typing_extensions import Self

ROWS, COLUMNS = 24, 80
LOOK_S = 0.1
SHOWN = 4000
"""Letters of what it has said, in an error."""


@functools.cache
def _broken(text: str) -> re.Pattern[str]:
    """The text, also where a word that is longer than a line was broken: a path, for one."""
    return re.compile(" ?".join(map(re.escape, text)))


class Terminal:
    """A context manager; the command is killed at its end."""

    def __init__(self, *command: str, patience_s: float, environ: Mapping[str, str] | None = None) -> None:
        """`patience_s`: for each of its words; `environ`: variables beside those of this process."""
        self._command, self._patience_s = command, patience_s
        self._environ = {**os.environ, "TERM": "xterm-256color", "NO_COLOR": "1", "PYTHONFAULTHANDLER": "1"}
        self._environ |= environ or {}
        self._read = 0
        self.said = ""
        """All that it has said."""
        self.answers = 0
        """So many lines were typed."""

    def __enter__(self) -> Self:
        self._end, inner = os.openpty()
        fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))

        def own_terminal() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            self._command, stdin=inner, stdout=inner, stderr=inner, env=self._environ, preexec_fn=own_terminal
        )
        os.close(inner)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._end)

    def reads(self, *texts: str) -> str:
        """Wait for the first of these, behind all that was read before. Returns what was said. Raises TrialError."""
        until_s = time.monotonic() + self._patience_s
        while True:
            # One line: where it is broken depends on lengths of paths.
            flat = " ".join(self.said.split())
            found = [match.end() for text in texts if (match := _broken(text).search(flat, self._read))]
            if found:
                before, self._read = self._read, min(found)
                return flat[before : self._read]
            if time.monotonic() > until_s or not self._hears():
                raise TrialError(f"it did not say {' or '.join(map(repr, texts))}, but: {flat[-SHOWN:]}")

    def _hears(self) -> bool:
        """Take in what it says; False: it has ended, as has everything that it has started here."""
        if not select.select([self._end], [], [], LOOK_S)[0]:
            return True
        with contextlib.suppress(OSError):
            if data := os.read(self._end, 65536):
                self.said += data.decode("utf-8", "replace")
                return True
        return False

    def _shows_where(self) -> None:
        """Python's fault handler adds each thread's stack to what a command has said, and ends it."""
        self.process.send_signal(signal.SIGABRT)
        while self._hears() and self.process.poll() is None:
            pass

    def types(self, answer: str = "") -> None:
        """Type a line."""
        self.presses(answer.encode() + b"\n")
        self.answers += 1

    def presses(self, keys: bytes) -> None:
        """Type as it is."""
        os.write(self._end, keys)

    def says(self, question: str, answer: str = "") -> None:
        """Answer a question once it is put."""
        self.reads(question)
        self.types(answer)

    def ends(self) -> int:
        """Wait for its end; returns its exit code. Raises TrialError."""
        until_s = time.monotonic() + self._patience_s
        while self.process.poll() is None:
            self._hears()
            if time.monotonic() > until_s:
                self._shows_where()
                raise TrialError(f"it does not end; it has said: {self.said[-SHOWN:]}")
        while select.select([self._end], [], [], 0)[0] and self._hears():
            pass
        return self.process.returncode
