"""Pty: the pseudo-terminal that a driver opens instead of the board's port, and the link to it.

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
"""How many bytes of a driver are read at once, so that a driver that writes without end does not keep other work
waiting."""
MODE = 0o660
GROUP = "failstop"


class Pty:
    """The pseudo-terminal, and the link to it at `path`."""

    def __init__(self, path: str) -> None:
        """Raises FailstopError."""
        self.path = path
        self.master = self.slave = -1
        self.name = ""
        """The path of the slave."""
        self._left = b""
        """The rest of an answer of which the driver has got the beginning."""
        self._lock = self._locked()
        try:
            self._open()
        except BaseException:
            self._close()
            os.close(self._lock)
            raise

    def _locked(self) -> int:
        """Take the lock next to the link, because two guards at one path would take it from each other. The lock's file
        is never removed, because then two guards could each lock a file of that name. Raises FailstopError."""
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
        """Allow the owner, and the group of the service's clients, to open the pseudo-terminal. If there is no such
        group, only the owner may."""
        import grp  # once

        with contextlib.suppress(KeyError, PermissionError):
            os.fchown(self.slave, -1, grp.getgrnam(GROUP).gr_gid)
            os.fchmod(self.slave, MODE)
            return
        os.fchmod(self.slave, 0o600)

    def _link(self) -> None:
        """Make the link. An existing link that leads nowhere, or to a terminal, is left from another guard and is
        replaced. Raises FailstopError."""
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
        """True if the link still leads here. When a service ends, it may remove its runtime directory with the link in
        it."""
        try:
            return os.readlink(self.path) == self.name
        except OSError:
            return False

    def link_again(self) -> None:
        """Make the link again. Raises FailstopError."""
        self._link()

    def read(self) -> tuple[bytes, bool]:
        """Returns what the driver has written, at most MOST_READ bytes, and True if nothing more waits."""
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
        """Give the driver an answer or a frame, whole. False if it does not read, and then this one is lost."""
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
        """Keep further programs out, as far as the kernel allows: root can still open the terminal. Raises HungUp."""
        with _alive():
            fcntl.ioctl(self.slave, termios.TIOCEXCL if on else termios.TIOCNXCL)

    def check(self) -> None:
        """Raise HungUp if somebody has hung up the terminal."""
        with _alive():
            termios.tcgetattr(self.slave)

    def clean(self) -> bytes:
        """Make the terminal as new for the next driver, after the last one has gone. Returns what the last driver wrote
        and nobody has read. Raises HungUp."""
        self._left = b""
        with _alive():
            # A driver that stopped its output (tcflow, or XOFF) would leave the next one's writes where nobody reads
            # them.
            termios.tcflow(self.slave, termios.TCOON)
            tty.setraw(self.slave, termios.TCSANOW)
            # Not what is on its way here: the next driver may have written already.
            termios.tcflush(self.slave, termios.TCIFLUSH)
        # Only now: while the terminal echoes, what the board said may come back here as if a driver had written it.
        found = b""
        while part := self.read()[0]:
            found = (found + part)[-MOST_READ:]
        self.exclusive(on=False)
        return found

    def hang_up(self) -> None:
        """Hang up. Every program that has the terminal open reads the end of file and can't write any more; a new pair
        takes its place. Raises FailstopError."""
        self._close()
        self._open()

    def _close(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1
        self._left = b""

    def close(self) -> None:
        """Remove the link, then hang up."""
        if self.linked():
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        self._close()
        os.close(self._lock)


@contextlib.contextmanager
def _alive() -> Iterator[None]:
    """Raise HungUp if the kernel's error means that somebody has hung up the terminal."""
    try:
        yield
    except (OSError, termios.error) as error:
        if error.args[0] != errno.EIO:
            raise
        raise HungUp from None
