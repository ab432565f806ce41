"""Pty: the pseudo-terminal that a driver opens in the place of the board's port, and the link by which it finds it.

Facts of Linux that this depends on:
- A fresh slave echoes and edits lines, so what the guard writes would come back as the driver's commands. The link is
  made when that is off.
- The exclusive mode that a driver sets (TIOCEXCL) outlives the driver, and only a descriptor of the slave can clear it.
  So the guard holds one, and uses that mode itself to keep out more programs than may have the port open.
- What a driver wrote before it died can still be read, and what it did not read is still there for the next one.
- Output that a driver has stopped (TCOOFF) stays stopped for the next one.
- Root can hang a terminal up (vhangup). Every descriptor of the slave is dead then, the guard's own one too.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import termios
import tty

from failstop.api.errors import FailstopError
from failstop.guard.news import HungUp

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator

READ_BYTES = 4096
MOST_READ = 65536
"""Bytes of a driver that are read at once, so that one that writes without end keeps nothing waiting for long."""
MODE = 0o660
GROUP = "failstop"


class Pty:
    """The pair, and its link at `path`."""

    def __init__(self, path: str) -> None:
        """Raises FailstopError."""
        self.path = path
        self.master = self.slave = -1
        self.name = ""
        """The slave's own path."""
        self._left = b""
        """The rest of an answer that the driver has begun to get."""
        self._lock = self._locked()
        try:
            self._open()
        except BaseException:
            self._close()
            os.close(self._lock)
            raise

    def _locked(self) -> int:
        """A lock next to the link, because two guards at one path would take it from each other. Its file stays: one
        that was taken away could be locked by two guards. Raises FailstopError."""
        path = f"{self.path}.lock"
        try:
            found = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise FailstopError(f"{path}: {error.strerror}; choose another place with --path") from None
        try:
            fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(found)
            raise FailstopError(
                f"another guard is running at {self.path}: stop it first, or choose another --path"
            ) from None
        return found

    def _open(self) -> None:
        self.master, self.slave = os.openpty()
        os.set_blocking(self.master, False)
        self.name = os.ttyname(self.slave)
        tty.setraw(self.slave)
        self._let_in()
        self._link()

    def _let_in(self) -> None:
        """The owner and the group of the service's clients may open it. Without that group the owner alone."""
        import grp  # once

        with contextlib.suppress(KeyError, PermissionError):
            os.fchown(self.slave, -1, grp.getgrnam(GROUP).gr_gid)
            os.fchmod(self.slave, MODE)
            return
        os.fchmod(self.slave, 0o600)

    def _link(self) -> None:
        """Put the link in its place. A link that leads nowhere, or to a terminal, was a guard's. Raises
        FailstopError."""
        draft = f"{self.path}.new"
        try:
            with contextlib.suppress(FileNotFoundError):
                if not stat.S_ISLNK(os.lstat(self.path).st_mode):
                    remedy = "remove it, or choose another --path"
                    raise FailstopError(f"{self.path} exists already and is not a link: {remedy}")
            with contextlib.suppress(FileNotFoundError):
                os.unlink(draft)
            os.symlink(self.name, draft)
            os.rename(draft, self.path)
        except OSError as error:
            raise FailstopError(f"{self.path}: {error.strerror}; choose another place with --path") from None

    def linked(self) -> bool:
        """Whether the link still leads here. A service that ends may take its runtime directory with it."""
        try:
            return os.readlink(self.path) == self.name
        except OSError:
            return False

    def link_again(self) -> None:
        """Put the link back. Raises FailstopError."""
        self._link()

    def read(self) -> tuple[bytes, bool]:
        """What the driver has written, MOST_READ at most; and whether nothing more waits."""
        found = bytearray()
        while len(found) < MOST_READ:
            try:
                part = os.read(self.master, READ_BYTES)
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EIO):
                    raise
                return bytes(found), True
            found += part
        return bytes(found), False

    def write(self, data: bytes) -> bool:
        """Give the driver one answer or frame, whole; False: it does not read, so this one is lost."""
        if self._left:
            self._left = self._left[self._put(self._left) :]
        if self._left:
            return False
        self._left = data[self._put(data) :]
        return len(self._left) < len(data)

    def _put(self, data: bytes) -> int:
        try:
            return os.write(self.master, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            return 0

    def exclusive(self, *, on: bool) -> None:
        """Keep every further program out, as far as the kernel does: root is let in all the same. Raises HungUp."""
        with _alive():
            fcntl.ioctl(self.slave, termios.TIOCEXCL if on else termios.TIOCNXCL)

    def check(self) -> None:
        """Raises HungUp."""
        with _alive():
            termios.tcgetattr(self.slave)

    def clean(self) -> bytes:
        """Make it as new for the next driver, once the last has gone; returns what that one wrote and nobody read.
        Raises HungUp."""
        found = b""
        while part := self.read()[0]:
            found = (found + part)[-MOST_READ:]
        self._left = b""
        with _alive():
            # A driver that stopped its output (tcflow, or XOFF) would leave the next one's writes where nobody reads
            # them.
            termios.tcflow(self.slave, termios.TCOON)
            tty.setraw(self.slave, termios.TCSANOW)
            # Not what is on its way here: the next driver may have written already.
            termios.tcflush(self.slave, termios.TCIFLUSH)
        self.exclusive(on=False)
        return found

    def hang_up(self) -> None:
        """Every program that has it open reads an end and can't write any more; a new pair takes its place. Raises
        FailstopError."""
        self._close()
        self._open()

    def _close(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1
        self._left = b""

    def close(self) -> None:
        """Take the link away, then hang up."""
        if self.linked():
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        self._close()
        os.close(self._lock)


@contextlib.contextmanager
def _alive() -> Iterator[None]:
    """Raises HungUp for what the kernel says of a terminal that was hung up."""
    try:
        yield
    except (OSError, termios.error) as error:
        if error.args[0] != errno.EIO:
            raise
        raise HungUp from None
