"""The simulated board's end of the wire: a pseudo-terminal, and the link that clients know it by.

A real port is freed by its last close: an exclusive claim (TIOCEXCL) ends and bytes nobody read are gone. A pty keeps
both for as long as its master is open (measured), so they are cleared here whenever the last client has left. For the
same reason the slave end is not held open here: it would hide that the last client has left.
"""

from __future__ import annotations

import errno
import fcntl
import os
import select
import stat
import termios
import time
import tty

from failstop_lab.sim.model import NEVER_NS

_READ_SIZE = 65536
# Reads in one go, so that a host that never stops writing cannot keep the board from doing anything else.
_READS = 64
_ALWAYS = select.EPOLLHUP | select.EPOLLERR


class SimError(Exception):
    """The simulated board cannot do that; the message is one line with the remedy."""


def check_link(link: str) -> None:
    """Raise SimError unless the link may be placed at this path: nothing there, or the link of a former board."""
    try:
        mode = os.lstat(link).st_mode
    except FileNotFoundError:
        directory = os.path.dirname(link) or "."
        if not os.path.isdir(directory):
            raise SimError(f"{directory} is not a directory: make it, or name another place for the link") from None
        return
    except OSError as error:
        raise SimError(f"cannot look at {link}: {error.strerror}: name another place for the link") from None
    if not stat.S_ISLNK(mode):
        raise SimError(f"{link} exists and is not a symbolic link: remove it, or name another place for the link")
    target = os.readlink(link)
    if not target.startswith("/dev/pts/"):
        raise SimError(f"{link} points to {target}, which is no simulated board: name another place for the link")


class PtyPort:
    """The port that clients open through `link`. `mode` are the node's permission bits (None: the system's default);
    with `cooked` a fresh port is in the terminal mode that the kernel gives a real one, echo and all."""

    def __init__(self, epoll: select.epoll, link: str, *, mode: int | None = None, cooked: bool = False) -> None:
        self.link = link
        self.node = ""
        self.master = -1
        self.draining = True
        # More may be waiting than the last poll() read.
        self.more = False
        self.lost_up_bytes = 0
        self.next_ns = NEVER_NS
        self._epoll = epoll
        self._mode = mode
        self._cooked = cooked
        self._poll = select.poll()

    @property
    def plugged(self) -> bool:
        """Whether the device is there."""
        return self.master >= 0

    @property
    def opened(self) -> bool:
        """Whether any client has the port open."""
        return self.plugged and not self._poll.poll(0)

    def info(self) -> dict[str, object]:
        """Nothing beyond what every port tells."""
        return {}

    def plug(self, link: str | None = None) -> None:
        """Make the device appear, as a new pty, at the former link or at another one. Raises SimError."""
        if self.plugged:
            raise SimError(f"the board is plugged in already, at {self.link}: unplug it first")
        if link is not None:
            check_link(link)
            self.link = link
        self._open()

    def unplug(self) -> None:
        """Make the device disappear: the name first, then everyone who has it open is hung up on."""
        if not self.plugged:
            return
        self.remove_link()
        self._close()

    def close(self) -> None:
        """Take the device away for good."""
        self.unplug()

    def remove_link(self) -> None:
        """Remove the link, if it is still this board's."""
        try:
            if os.readlink(self.link) == self.node:
                os.unlink(self.link)
        except OSError:
            # Not there, or something else by now: nothing of this board's.
            pass

    def owns(self, descriptor: int) -> bool:
        """Whether a descriptor that epoll reported is this port's."""
        return descriptor == self.master

    def reported(self, mask: int) -> None:
        """Handle what epoll reported of this descriptor. A hang-up may mean that the last client has closed the
        port."""
        if mask & select.EPOLLHUP:
            self.free()

    def poll(self) -> list[tuple[int, bytes]]:
        """Read what has arrived: (time at which the read returned, bytes) each. Nothing while not draining."""
        chunks: list[tuple[int, bytes]] = []
        self.more = False
        if not self.plugged or not self.draining:
            return chunks
        for _ in range(_READS):
            try:
                chunk = os.read(self.master, _READ_SIZE)
                t_ns = time.monotonic_ns()
            except BlockingIOError:
                return chunks
            except OSError as error:
                # EIO: no client has the port open.
                if error.errno != errno.EIO:
                    raise
                return chunks
            chunks.append((t_ns, chunk))
        self.more = True
        return chunks

    def send(self, frame: bytes) -> None:
        """Send to whoever has the port open; bytes that find no room or no reader are lost, as on a real port."""
        if not self.opened:
            return
        try:
            sent = os.write(self.master, frame)
        except OSError:
            sent = 0
        self.lost_up_bytes += len(frame) - sent

    def free(self) -> None:
        """The last client may have left: undo what a real port's last close undoes, if so."""
        if not self.plugged or self.opened:
            return
        try:
            slave = os.open(self.node, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            # Only root can open a pty that is still claimed. A fresh one under the same name looks the same to clients.
            self._renew()
            return
        fcntl.ioctl(slave, termios.TIOCNXCL)
        termios.tcflush(slave, termios.TCIFLUSH)
        os.close(slave)
        self._forget_own_hangup()

    def _forget_own_hangup(self) -> None:
        # Closing the slave in free() was a hang-up like a client's; left in the queue it would bring us there again.
        # Other descriptors are watched by level and will be reported once more.
        for descriptor, mask in self._epoll.poll(0):
            if descriptor == self.master and mask & select.EPOLLIN:
                self.more = True

    def _open(self) -> None:
        try:
            self.master, slave = os.openpty()
        except OSError as error:
            raise SimError(f"cannot make a pty: {error.strerror}: is /dev/pts mounted, or full?") from None
        try:
            self.node = os.ttyname(slave)
            if not self._cooked:
                tty.setraw(slave, termios.TCSANOW)
            if self._mode is not None:
                os.chmod(slave, self._mode)
        finally:
            os.close(slave)
        os.set_blocking(self.master, False)
        # By edge: a pty without a client is hung up all the time, and would be reported all the time.
        self._epoll.register(self.master, select.EPOLLIN | select.EPOLLET)
        self._poll.register(self.master, _ALWAYS)
        self.more = True
        self._place_link()

    def _renew(self) -> None:
        former = self.master
        self._forget(former)
        self._open()
        # Not before: the link always leads somewhere.
        os.close(former)

    def _close(self) -> None:
        self._forget(self.master)
        os.close(self.master)
        self.master = -1

    def _forget(self, master: int) -> None:
        self._epoll.unregister(master)
        self._poll.unregister(master)

    def _place_link(self) -> None:
        beside = f"{self.link}.{os.getpid()}.new"
        try:
            os.symlink(self.node, beside)
            os.rename(beside, self.link)
        except OSError as error:
            self._close()
            text = os.strerror(error.errno or 0)
            raise SimError(f"cannot place the link {self.link}: {text}: name another place for the link") from None
