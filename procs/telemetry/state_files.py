"""Files in the state directory. A thread writes them, so that a slow disk can't hold up the loop. A line is written
whole or not at all. A failed write only adds a line to the journal."""

from __future__ import annotations

import _thread
import os
from _queue import SimpleQueue
from collections.abc import Callable
from errno import ENOSPC

from failstop.files import durable

Job = tuple[str, Callable[[], None]]

THREAD_STACK_BYTES = 256 * 1024
"""The stack size of the thread that writes. It is small, because the whole stack counts against the limit of locked
memory, although only the part that is used is locked."""
MOST_JOBS = 100
"""How many jobs may wait for the disk. If this many wait already, a new job is dropped. With one line every 10 s, this
is enough for a quarter of an hour."""


def append_line(path: str, header: str, line: str) -> None:
    """Append a whole line to a file. A new file begins with the header. Raises OSError, and then the file is
    unchanged."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    fd = durable.open_own(path, os.O_RDWR | os.O_APPEND | os.O_CREAT)
    try:
        size = os.fstat(fd).st_size
        # If a power cut has truncated the last line, end that line, so that it doesn't spoil the next one.
        torn = size > 0 and os.pread(fd, 1, size - 1) != b"\n"
        data = (("\n" if torn else "" if size else header) + line).encode()
        if os.write(fd, data) != len(data):
            os.ftruncate(fd, size)
            raise OSError(ENOSPC, os.strerror(ENOSPC), path)
    finally:
        os.close(fd)


class StateFiles:
    """Writes the files. Only _work() runs in the thread; everything else runs in the loop."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._notes: SimpleQueue[tuple[str, str]] = SimpleQueue()
        self._failing: dict[str, str] = {}
        """The files whose last write failed, each with the reason. Only the thread uses this dict. If no thread could
        be started, the loop uses it."""
        self._running = False

    def append(self, what: str, name: str, header: str, line: str) -> None:
        """Append a line to a file; the thread does it soon. `what`: what the journal calls this file."""
        self._put(what, lambda: append_line(os.path.join(self.folder, name), header, line))

    def notes(self) -> list[tuple[str, str]]:
        """Return the new lines for the journal, as (text, what to do about it)."""
        return [self._notes.get() for _ in range(self._notes.qsize())]

    def _put(self, what: str, write: Callable[[], None]) -> None:
        if not self._running:
            try:
                _thread.stack_size(THREAD_STACK_BYTES)
                _thread.start_new_thread(self._work, ())
            except RuntimeError as error:
                self._say(what, f"no thread to write it: {error}")
                return
            self._running = True
        if self._jobs.qsize() < MOST_JOBS:
            self._jobs.put((what, write))

    def _work(self) -> None:
        while True:
            what, write = self._jobs.get()
            try:
                write()
            except OSError as error:
                self._say(what, f"{error}")
            else:
                if self._failing.pop(what, ""):
                    self._notes.put((f"{what} is written again", ""))

    def _say(self, what: str, why: str) -> None:
        if self._failing.get(what) != why:
            self._failing[what] = why
            self._notes.put((f"{what} can't be written: {why}", f"look at the disk and at {self.folder}"))
