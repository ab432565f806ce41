"""Pty: the pseudo-terminal that a driver opens instead of the board's port, and the link that leads to it. The driver's
end of a pseudo-terminal is called the slave.

This file depends on these facts about Linux:

- A new slave echoes what it receives, and edits lines. The guard would read its own bytes back as if the driver had
  written them. So the guard switches off echo and editing before it makes the link.
- If a driver sets the exclusive mode (TIOCEXCL), the mode stays set after the driver has ended, and only a descriptor
  of the slave can clear it. So the guard keeps a descriptor of the slave. The guard also sets the exclusive mode
  itself, when as many programs have the port open as allowed.
- After a driver has died, the guard can still read what the driver wrote. Bytes that the driver did not read are still
  there, and the next driver would read them.
- If a driver stops the output of the terminal (TCOOFF), the output stays stopped for the next driver.
- All programs that have the slave open share its settings, and the bytes that wait to be read. So only when no program
  has it open may the guard set it up again.
- Root can hang up a terminal (vhangup). All descriptors of the slave are dead then, even the guard's own descriptor.
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
from failstop.guard.openers import Watch

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator

READ_BYTES = 4096
MOST_READ = 65536
"""How many bytes from a driver are read at once, roughly. Without this limit, a driver that writes without end would
keep the guard from its other work."""
TERMINALS = "/dev/pts/"
"""The folder of the slaves of all pseudo-terminals."""
MODE = 0o660
GROUP = "failstop"


class Pty:
    """The pseudo-terminal, and the link at `path` that leads to it."""

    watch: Watch
    """Reports when a program opens or closes the terminal. It begins before the link is made, because a driver that
    waits for its port opens the link at once."""

    def __init__(self, path: str) -> None:
        """`path`: where to make the link. Raises FailstopError or OSError."""
        self.path = path
        self.master = self.slave = -1
        self.name = ""
        """The path of the slave."""
        self._left = b""
        """The rest of an answer of which the terminal has accepted only the beginning."""
        self._open_files = contextlib.ExitStack()
        """Closes what belongs to the present pseudo-terminal."""
        self._lock = self._locked()
        try:
            self._open()
        except BaseException:
            self._close()
            os.close(self._lock)
            raise

    def _locked(self) -> int:
        """Lock the file `path`.lock, and return its descriptor. The lock keeps two guards from taking the link from
        each other. The lock file is never removed, because two guards could then each lock a different file with the
        same name. Raises FailstopError."""
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
        for fd in (self.master, self.slave):
            self._open_files.callback(os.close, fd)
        os.set_blocking(self.master, False)
        self.name = os.ttyname(self.slave)
        tty.setraw(self.slave)
        self._let_in()
        self.watch = Watch(self.name)
        self._open_files.callback(self.watch.close)
        self._link()

    def _let_in(self) -> None:
        """Let the guard's own user, and the group of the service's clients, open the pseudo-terminal. If the
        group does not exist, or the guard may not give the terminal to it, only the guard's own user may open it."""
        import grp  # once

        with contextlib.suppress(KeyError, PermissionError):
            os.fchown(self.slave, -1, grp.getgrnam(GROUP).gr_gid)
            os.fchmod(self.slave, MODE)
            return
        os.fchmod(self.slave, 0o600)

    def _link(self) -> None:
        """Make the link. A link to another pseudo-terminal is replaced, because an earlier guard may have left it.
        Raises FailstopError, also if anything else is at the path, for example a link that a udev rule has made."""
        draft = f"{self.path}.new"
        try:
            with contextlib.suppress(FileNotFoundError):
                if not stat.S_ISLNK(os.lstat(self.path).st_mode):
                    remedy = "remove it, or choose another --path"
                    raise FailstopError(f"{self.path} exists already and is not a link: {remedy}")
                if not (leads_to := os.readlink(self.path)).startswith(TERMINALS):
                    raise FailstopError(f"{self.path} leads to {leads_to}: choose another --path")
            with contextlib.suppress(FileNotFoundError):
                os.unlink(draft)
            os.symlink(self.name, draft)
            os.rename(draft, self.path)
        except OSError as error:
            raise FailstopError(f"{self.path}: {error.strerror}; choose another place with --path") from None

    def linked(self) -> bool:
        """True if the link still leads to this pseudo-terminal. A service that ends may remove its runtime directory
        with the link in it."""
        try:
            return os.readlink(self.path) == self.name
        except OSError:
            return False

    def link_again(self) -> None:
        """Make the link again after it was lost. Raises FailstopError."""
        self._link()

    def read(self) -> tuple[bytes, bool]:
        """Read what the driver has written, about MOST_READ bytes at most. Returns (the bytes, True if no more bytes
        are waiting)."""
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
        """Write one answer or one frame to the driver. If the terminal does not accept all bytes, the next call first
        writes the rest. As long as a rest is left, new `data` is dropped. Returns False if no byte of `data` was
        accepted."""
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
        """If `on`, keep more programs from opening the terminal. Otherwise allow it again. Root can always open the
        terminal. Raises HungUp."""
        with _alive():
            fcntl.ioctl(self.slave, termios.TIOCEXCL if on else termios.TIOCNXCL)

    def check(self) -> None:
        """Raise HungUp if somebody has hung up the terminal."""
        with _alive():
            termios.tcgetattr(self.slave)

    def clean(self, *, shared: bool = False, opened: bool = False) -> bytes:
        """Reset the terminal after a driver has gone. Returns the newest bytes that were written and not read yet, at
        most MOST_READ. Raises HungUp.

        `shared`: True if another program has had the terminal open all the time. For this program nothing changes, as
        on a serial port. `opened`: True if a program may have opened the terminal since. The settings of the terminal
        may be this program's then, so they are kept."""
        with _alive():
            if not shared:
                self._left = b""
                # If a driver has stopped the output (tcflow, or XOFF), what the next driver writes would not arrive
                # here.
                termios.tcflow(self.slave, termios.TCOON)
            if shared or opened:
                self._stop_echo()
            else:
                tty.setraw(self.slave, termios.TCSANOW)
            if not shared:
                # Drop only what the last driver did not read. What is on its way here may be from the next driver
                # already.
                termios.tcflush(self.slave, termios.TCIFLUSH)
        # Read only after that. As long as the terminal echoes, the board's bytes may come back as if a driver wrote
        # them.
        found = b""
        while part := self.read()[0]:
            found = (found + part)[-MOST_READ:]
        return found

    def _stop_echo(self) -> None:
        """Switch off the echo if it is on, and leave every other setting as it is."""
        settings = termios.tcgetattr(self.slave)
        if settings[3] & termios.ECHO:
            settings[3] &= ~termios.ECHO
            termios.tcsetattr(self.slave, termios.TCSANOW, settings)

    def hang_up(self) -> None:
        """Close the pseudo-terminal and open a new one. A program that still has the old one open reads the end of the
        file, and can't write any more. Raises FailstopError or OSError."""
        self._close()
        self._open()

    def _close(self) -> None:
        self._open_files.close()
        self.master = self.slave = -1
        self._left = b""

    def close(self) -> None:
        """Remove the link, then close the pseudo-terminal."""
        if self.linked():
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        self._close()
        os.close(self._lock)


@contextlib.contextmanager
def _alive() -> Iterator[None]:
    """Raise HungUp if an error inside the `with` block shows that somebody has hung up the terminal."""
    try:
        yield
    except (OSError, termios.error) as error:
        if error.args[0] != errno.EIO:
            raise
        raise HungUp from None
