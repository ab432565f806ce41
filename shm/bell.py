"""Bells wake processes. A bell carries no data. It only tells a process to look at the shared memory. If a ring is
lost, the process looks at the next tick of its loop. A loop can wait for several bells and other descriptors in one
epoll set.

An EventBell (an eventfd) is for the service's own processes, which inherit it. A pipe (a FIFO in the runtime directory)
is for clients. Each byte in the pipe is the number of the slot to look at. This number is only a hint, because any byte
rings the bell.
"""

from __future__ import annotations

import contextlib
import errno
import os

from failstop.files import place

_ONE = (1).to_bytes(8, "little")


class EventBell:
    """A bell between the service's processes (an eventfd). Any number of rings cause one wake-up."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    @classmethod
    def create(cls) -> EventBell:
        """Create a bell. Processes started later inherit it only if it is passed on explicitly."""
        return cls(os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC))

    def ring(self) -> None:
        """Wake the process that waits for this bell. Never blocks: if the eventfd's counter is full, the bell is still
        ringing."""
        # Not contextlib.suppress, because it costs more than the call itself. The same applies to clear().
        try:  # noqa: SIM105
            os.write(self.fd, _ONE)
        except BlockingIOError:
            pass

    def clear(self) -> None:
        """Clear all rings up to now. Call this before you look for work, so that a ring during the work wakes you
        again."""
        try:  # noqa: SIM105
            os.read(self.fd, 8)
        except BlockingIOError:
            pass


def make_pipe(path: str, mode: int, gid: int = -1) -> None:
    """Create a FIFO with exactly the given mode. If a dead run has left a file at this path, the file is replaced.
    Raises OSError."""
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
    """Open the service's end of a FIFO, for reading and writing. A FIFO that is open only for reading reads an end of
    file when the last client leaves."""
    return place.opened(path, os.O_RDWR, pipe=True)


def open_pipe_to_write(path: str) -> int:
    """Open a client's end of a FIFO. Raises FileNotFoundError, or OSError with ENXIO, if no service runs. Also raises
    place.Untrusted and other OSErrors."""
    return place.opened(path, os.O_WRONLY, pipe=True)


def send(fd: int, data: bytes) -> bool:
    """Write at most PIPE_BUF bytes, completely or not at all. Returns False if the pipe is full. The bytes in a
    full pipe wake the service anyway. Raises BrokenPipeError if the service is gone, or another OSError."""
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
"""A buffer for receive(). It is made when this file is imported, because the reader of stop requests must keep working
even if the machine has no memory left."""


def receive(fd: int) -> bytes:
    """Read all bytes that wait in a pipe, at most MOST_BYTES. Returns no bytes if none wait."""
    try:
        return bytes(memoryview(_received)[: os.readv(fd, (_received,))])
    except BlockingIOError:
        return b""
