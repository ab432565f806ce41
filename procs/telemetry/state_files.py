"""Files in the state directory. They are written whole or not at all, by a thread, because a slow disk must not hold up
the loop.

If a file can't be written, that costs one line in the journal and nothing else.
"""

from __future__ import annotations

import _thread
import os
from _queue import SimpleQueue
from collections.abc import Callable
from errno import ENOSPC

from failstop.files import durable

Job = tuple[str, Callable[[], None]]

THREAD_STACK_BYTES = 256 * 1024
"""The stack size of the thread. Memory is locked only when it is touched, but all of it counts against the limit before
that."""
MOST_READ = 4096
"""The most bytes of a file that are read. Each of these files holds one line."""
MOST_JOBS = 100
"""How many jobs may wait for the disk. With a line every 10 s, that is a quarter of an hour."""


def append_line(path: str, header: str, line: str) -> None:
    """Append a whole line; a new file starts with the header. Raises OSError, and then the file is as it was."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    fd = durable.open_own(path, os.O_RDWR | os.O_APPEND | os.O_CREAT)
    try:
        size = os.fstat(fd).st_size
        # A line that a power cut has truncated is ended, so that it doesn't spoil the next.
        torn = size > 0 and os.pread(fd, 1, size - 1) != b"\n"
        data = (("\n" if torn else "" if size else header) + line).encode()
        if os.write(fd, data) != len(data):
            os.ftruncate(fd, size)
            raise OSError(ENOSPC, os.strerror(ENOSPC), path)
    finally:
        os.close(fd)


def write_whole(path: str, text: str) -> None:
    """Replace a file's content, whole or not at all. Raises OSError, and then the old content is unchanged."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    draft = f"{path}.new"
    durable.write_draft(draft, text.encode())
    durable.publish(draft, path)


class StateFiles:
    """Jobs for the thread, and their results. Everything except for _work runs in the loop's thread."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._notes: SimpleQueue[tuple[str, str]] = SimpleQueue()
        self._failing: dict[str, str] = {}
        """The files whose last write failed, and why. Used only by the thread."""
        self._running = False

    def read(self, what: str, name: str) -> str:
        """The text of a file; empty if it does not exist. Call it only at the start, because it does not use the
        thread."""
        try:
            fd = durable.open_own(os.path.join(self.folder, name))
            try:
                return os.read(fd, MOST_READ).decode("utf-8", "replace")
            finally:
                os.close(fd)
        except FileNotFoundError:
            return ""
        except OSError as error:
            self._notes.put((f"{what} can't be read: {error}", ""))
            return ""

    def append(self, what: str, name: str, header: str, line: str) -> None:
        """Append a line to a file soon. `what`: the file's name in the journal."""
        self._put(what, lambda: append_line(os.path.join(self.folder, name), header, line))

    def replace(self, what: str, name: str, text: str) -> None:
        self._put(what, lambda: write_whole(os.path.join(self.folder, name), text))

    def notes(self) -> list[tuple[str, str]]:
        """Lines for the journal since the last call, each with the step to take."""
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
