"""Bells: wake-ups that fit one epoll set. A bell says "look", never what; one that is lost costs a tick, no data.

EventBell (an eventfd) rings between the service's own processes, which inherit it. PipeBell (a FIFO in the runtime
directory) is for clients: its bytes are hints which slots to look at, and any bytes at all are a ring.
"""

from __future__ import annotations

import contextlib
import errno
import os

from failstop.files import place

_ONE = (1).to_bytes(8, "little")


class EventBell:
    """An eventfd: any number of rings are one wake-up."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    @classmethod
    def create(cls) -> EventBell:
        """A new bell, closed on exec unless passed on."""
        return cls(os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC))

    def ring(self) -> None:
        """Wake whoever waits. A counter that is full (nobody has looked for ages) rings already."""
        # Not contextlib.suppress: it costs more than the call, here and below.
        try:  # noqa: SIM105
            os.write(self.fd, _ONE)
        except BlockingIOError:
            pass

    def clear(self) -> None:
        """Take the rings so far; call before looking, so that a later ring is not lost."""
        try:  # noqa: SIM105
            os.read(self.fd, 8)
        except BlockingIOError:
            pass


def make_pipe(path: str, mode: int, gid: int = -1) -> None:
    """Make a FIFO with exactly this mode, in place of whatever a dead run left there. Raises OSError."""
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
    """The service's end, opened for both so that it never sees an end of file when the last client leaves."""
    return place.opened(path, os.O_RDWR, pipe=True)


def open_pipe_to_write(path: str) -> int:
    """A client's end. Raises OSError (FileNotFoundError or ENXIO without a service), place.Untrusted among them."""
    return place.opened(path, os.O_WRONLY, pipe=True)


def send(fd: int, data: bytes) -> bool:
    """Write at most PIPE_BUF bytes whole; False when the pipe is full, which rings just as well."""
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
_taken = bytearray(MOST_BYTES)
"""Made beforehand: whoever reads stop requests must live on where no process may have more memory."""


def take(fd: int) -> bytes:
    """Everything that waits in a pipe, up to MOST_BYTES; empty when nothing does."""
    try:
        return bytes(memoryview(_taken)[: os.readv(fd, (_taken,))])
    except BlockingIOError:
        return b""
