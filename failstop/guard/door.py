"""Door: watches which programs have the pseudo-terminal open, as far as Linux shows this, and limits how many times the
pseudo-terminal may be open.

When a program is killed, the guard notices the end in three steps. First, /proc shows that the process is ending; the
guard looks there a few hundred times per second. Then the kernel frees the program's memory and closes its files, and
inotify reports the close. Finally, the program's pidfd reports that the program is gone.

A child may keep the port open after its parent has ended or has closed the port. The guard notices this in two ways:

- The pidfd reports that the parent is gone, but inotify has reported no close.
- /proc shows that the parent has no descriptor of the port any more, but inotify has reported no close.
"""

from __future__ import annotations

import contextlib
import os
import select

from failstop.guard.news import News, Opener
from failstop.guard.openers import dying, holds, identity, openers

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.guard.pty import Pty


class Door:
    """Watches the programs that have the pseudo-terminal open, and wakes the guard when something changes."""

    def __init__(self, pty: Pty) -> None:
        """`pty`: the pseudo-terminal to watch."""
        self._pty, self._poll = pty, select.epoll()
        self.seen: dict[int, Opener] = {}
        """The programs that have opened the pseudo-terminal, by pid, as far as /proc shows them."""
        self.count = 0
        """How many times the pseudo-terminal is open, as far as the guard knows."""
        self._opened = 0
        """How many times the pseudo-terminal is open according to inotify, which also counts programs that /proc does
        not show."""
        self.most = 1
        """How many times the pseudo-terminal may be open at once."""
        self._lives: dict[int, int] = {}
        """The pidfd of each program in `seen`, and of each program that is dying."""
        self._dying: dict[int, tuple[Opener, int]] = {}
        """Each dying program, by pid, with the number of its closes that inotify has not reported yet."""
        self._closed: set[int] = set()
        """The programs that had no descriptor of the pseudo-terminal when abandoned() last looked."""
        self._begin()

    def _begin(self) -> None:
        for fd in self._fds():
            self._poll.register(fd, select.EPOLLIN)

    def _fds(self) -> tuple[int, int]:
        return self._pty.master, self._pty.watch.fd

    @property
    def vacant(self) -> bool:
        """True if no program has the pseudo-terminal open. False if one may have opened it since the last look()."""
        return not self.count and not self._pty.watch.stirs()

    @property
    def crowded(self) -> bool:
        """True if the pseudo-terminal is open more times than allowed."""
        return self.count > self.most

    def wait(self, seconds: float) -> dict[int, int]:
        """Sleep until a program has written to the port, opened or closed it, or has died, but at most for `seconds`.
        Returns the argument for look()."""
        return dict(self._poll.poll(seconds))

    def look(self, ready: dict[int, int]) -> News:
        """Return what has happened since the previous call. This must be quick, because the driver's bytes are read
        only afterwards, and they may be a stop."""
        news = News()
        for pid, opener in self.seen.items():
            if pid not in self._dying and (self._lives.get(pid) in ready or dying(pid)):
                self._dying[pid] = opener, opener.times
                self.count = max(0, self.count - opener.times)
                news.ended = news.any = True
                news.emptied |= not self.count
        for opened in self._pty.watch.events():
            news.any = True
            self._opened = max(0, self._opened + (1 if opened else -1))
            if opened:
                self.count += 1
            elif not self._expected() and self.count:
                self.count -= 1
                news.ended = True
                news.emptied |= not self.count
        for pid in [pid for pid in self._dying if self._lives.get(pid) in ready or pid not in self._lives]:
            opener, left = self._dying.pop(pid)
            news.any = True
            if left and pid in self._lives:
                news.orphans.append(opener)
        return news

    def _expected(self) -> bool:
        """Assign a close that inotify has just reported to a dying program. Returns False if no dying program has
        closes left to report."""
        for pid, (opener, left) in self._dying.items():
            if left:
                self._dying[pid] = opener, left - 1
                return True
        return False

    def abandoned(self) -> list[Opener]:
        """The programs that have closed the pseudo-terminal while a child still has it open. A program is returned only
        if it had no descriptor at two calls in a row, because inotify may report its close a little later. Raises
        OSError."""
        wanted, before, self._closed = identity(self._pty.name), self._closed, set()
        for pid in self.seen.keys() - self._dying.keys():
            with contextlib.suppress(PermissionError):  # nobody knows whether this program has closed it
                if not holds(pid, wanted):
                    self._closed.add(pid)
        return [self.seen[pid] for pid in self._closed & before]

    def recount(self, meanwhile: Callable[[], None]) -> None:
        """Find out which programs have the pseudo-terminal open. Once the terminal is open as many times as allowed,
        the kernel refuses more programs. `meanwhile`: called again and again during the search (see openers())."""
        found, hidden = openers(self._pty.name, self.seen, self._opened, meanwhile)
        seen = {pid: opener for pid, opener in found.items() if pid not in self._dying and not dying(pid)}
        shown = sum(opener.times for opener in seen.values())
        if not hidden:
            self._opened = min(self._opened, shown)
        closing = sum(left for _, left in self._dying.values())
        self.count = max(self._opened - closing, shown) if hidden else shown
        self._update_lives(seen)
        self.limit()

    def limit(self) -> None:
        """Have the kernel refuse more programs if the pseudo-terminal is open as many times as allowed, and let them in
        if it is not."""
        self._pty.exclusive(on=self.count >= self.most)

    def _update_lives(self, seen: dict[int, Opener]) -> None:
        for pid in self._lives.keys() - seen.keys() - self._dying.keys():
            fd = self._lives.pop(pid)
            self._poll.unregister(fd)
            os.close(fd)
        for pid in seen.keys() - self._lives.keys():
            with contextlib.suppress(OSError):  # the program has ended meanwhile, and closed the port
                self._lives[pid] = os.pidfd_open(pid)
                self._poll.register(self._lives[pid], select.EPOLLIN)
        self.seen = seen

    def hang_up(self) -> None:
        """Take the port away from all programs: close the pseudo-terminal and open a new one. Raises FailstopError or
        OSError."""
        for fd in self._fds():
            self._poll.unregister(fd)
        self._pty.hang_up()
        self._dying.clear()
        self._update_lives({})
        self.count = self._opened = 0
        self._begin()

    def close(self) -> None:
        self._dying.clear()
        self._update_lives({})
        self._poll.close()
