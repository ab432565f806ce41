"""Bells: wake-ups that can be waited for in one epoll set. A bell only says "look", and carries no data, so a lost ring
delays the reader by a tick but loses nothing.

EventBell (an eventfd) rings between the service's own processes, which inherit it. PipeBell (a FIFO in the runtime
directory) is for clients: each byte hints at a slot to look at, and any byte at all is a ring.
"""

from __future__ import annotations

import contextlib
import errno
import os

from failstop.files import place

_ONE = (1).to_bytes(8, "little")


class EventBell:
    """An eventfd: any number of rings cause one wake-up."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    @classmethod
    def create(cls) -> EventBell:
        """A new bell, closed on exec unless passed on."""
        return cls(os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC))

    def ring(self) -> None:
        """Wake the process that waits. If the counter is full, because nobody has looked for very long, the bell is
        ringing already."""
        # Not contextlib.suppress, which costs more than the call, here and below.
        try:  # noqa: SIM105
            os.write(self.fd, _ONE)
        except BlockingIOError:
            pass

    def clear(self) -> None:
        """Clear the rings so far. Call it before looking, so that a later ring is not lost."""
        try:  # noqa: SIM105
            os.read(self.fd, 8)
        except BlockingIOError:
            pass


def make_pipe(path: str, mode: int, gid: int = -1) -> None:
    """Create a FIFO with exactly this mode, replacing a dead run's file. Raises OSError."""
    above, name = os.path.split(path)
    where = place.directory(above)
    try:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name, dir_fd=where)
        os.mkfifo(name, 0o600, dir_fd=where)
        if gid >= 0:
            os.chown(name, -1, gid, dir_fd=where)
        os.chmod(name, mode, dir_fd=where)
    finally:
        os.close(where)


def open_pipe(path: str) -> int:
    """Open the service's end, for reading and writing, so that it never sees an end of file when the last client
    leaves."""
    return place.opened(path, os.O_RDWR, pipe=True)


def open_pipe_to_write(path: str) -> int:
    """Open a client's end. Raises OSError: FileNotFoundError or ENXIO without a service, or place.Untrusted."""
    return place.opened(path, os.O_WRONLY, pipe=True)


def send(fd: int, data: bytes) -> bool:
    """Write at most PIPE_BUF bytes, whole. False if the pipe is full; that rings the bell as well."""
    try:
        os.write(fd, data)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in (errno.EPIPE, errno.ENXIO):
            raise BrokenPipeError(error.errno, "the service has gone") from None
        raise
    return True


MOST_BYTES = 65536
_received = bytearray(MOST_BYTES)
"""Allocated in advance, because the reader of stop requests must keep working when no process can get more memory."""


def receive(fd: int) -> bytes:
    """All bytes that wait in a pipe, up to MOST_BYTES; empty if there are none."""
    try:
        return bytes(memoryview(_received)[: os.readv(fd, (_received,))])
    except BlockingIOError:
        return b""
