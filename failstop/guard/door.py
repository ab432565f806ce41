"""Door: who has the pseudo-terminal open, as far as anybody can see, and how many may.

A program that is killed is seen first in /proc, by the SIGKILL that waits for it or by its flags, which are looked at a
few hundred times a second. Then the kernel takes its memory down, closes its files, which inotify reports, and at last
its pidfd says that it is gone. A program whose pidfd has said so, and of which no close was reported, has left the port
open with a child of its. So has one that has closed all its descriptors while no close was reported.
"""

from __future__ import annotations

import contextlib
import os
import select

from failstop.guard.news import News, Opener
from failstop.guard.openers import Watch, dying, holds, identity, openers

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.guard.pty import Pty


class Door:
    """The programs that have it open, and what wakes the guard."""

    def __init__(self, pty: Pty) -> None:
        """Raises OSError."""
        self._pty, self._poll = pty, select.epoll()
        self.seen: dict[int, Opener] = {}
        """The programs that have opened it, as far as /proc shows them, by pid."""
        self.count = 0
        """How often it is open, as far as is known."""
        self._opened = 0
        """How often it is open by inotify alone, which also reports the programs that /proc does not show."""
        self.most = 1
        """How often it may be."""
        self._lives: dict[int, int] = {}
        """For each of these programs, and each that is dying, the descriptor that reports its end."""
        self._dying: dict[int, tuple[Opener, int]] = {}
        """Those whose end was noticed, with the closes that inotify has not reported of them yet."""
        self._closed: set[int] = set()
        """Programs that had no descriptor of it when abandoned() looked last."""
        self._begin()

    def _begin(self) -> None:
        self._watch = Watch(self._pty.name)
        for fd in (self._pty.master, self._watch.fd):
            self._poll.register(fd, select.EPOLLIN)

    @property
    def crowded(self) -> bool:
        """More programs have it open than may."""
        return self.count > self.most

    def wait(self, seconds: float) -> dict[int, int]:
        """Sleep until a driver has written, or comes or goes; at most so long. Returns what look() needs."""
        return dict(self._poll.poll(seconds))

    def look(self, ready: dict[int, int]) -> News:
        """What has happened since the last look. Cheap, because a stop waits for it."""
        news = News()
        for pid, opener in self.seen.items():
            if pid not in self._dying and (self._lives.get(pid) in ready or dying(pid)):
                self._dying[pid] = opener, opener.times
                self.count = max(0, self.count - opener.times)
                news.ended = news.any = True
        for opened in self._watch.events():
            news.any = True
            self._opened = max(0, self._opened + (1 if opened else -1))
            if opened:
                self.count += 1
            elif not self._expected() and self.count:
                self.count -= 1
                news.ended = True
        for pid in [pid for pid in self._dying if self._lives.get(pid) in ready or pid not in self._lives]:
            opener, left = self._dying.pop(pid)
            news.any = True
            if left and pid in self._lives:
                news.orphans.append(opener)
        return news

    def _expected(self) -> bool:
        """Whether this close is one of a program whose end was noticed before."""
        for pid, (opener, left) in self._dying.items():
            if left:
                self._dying[pid] = opener, left - 1
                return True
        return False

    def abandoned(self) -> list[Opener]:
        """The programs that have closed it and left it open with a child. Each is looked for twice, because the close
        that the kernel reports may be on its way. Raises OSError."""
        wanted, before = identity(self._pty.name), self._closed
        with contextlib.suppress(PermissionError):
            self._closed = {pid for pid in self.seen if pid not in self._dying and not holds(pid, wanted)}
        return [self.seen[pid] for pid in self._closed & before]

    def recount(self, meanwhile: Callable[[], None]) -> None:
        """See who has it open, and keep further programs out where it is open as often as may be. `meanwhile`: as of
        openers()."""
        found, hidden = openers(self._pty.name, self.seen, self._opened, meanwhile)
        seen = {pid: opener for pid, opener in found.items() if pid not in self._dying and not dying(pid)}
        shown = sum(opener.times for opener in seen.values())
        if not hidden:
            self._opened = min(self._opened, shown)
        closing = sum(left for _, left in self._dying.values())
        self.count = max(self._opened - closing, shown) if hidden else shown
        self._update_lives(seen)
        self._pty.exclusive(on=self.count >= self.most)

    def _update_lives(self, seen: dict[int, Opener]) -> None:
        for pid in self._lives.keys() - seen.keys() - self._dying.keys():
            fd = self._lives.pop(pid)
            self._poll.unregister(fd)
            os.close(fd)
        for pid in seen.keys() - self._lives.keys():
            with contextlib.suppress(OSError):  # it has ended meanwhile, and closed it
                self._lives[pid] = os.pidfd_open(pid)
                self._poll.register(self._lives[pid], select.EPOLLIN)
        self.seen = seen

    def hang_up(self) -> None:
        """Everybody is out, and another terminal is there. Raises FailstopError, OSError."""
        self._poll.unregister(self._pty.master)
        self._close_watch()
        self._pty.hang_up()
        self._dying.clear()
        self._update_lives({})
        self.count = self._opened = 0
        self._begin()

    def _close_watch(self) -> None:
        self._poll.unregister(self._watch.fd)
        self._watch.close()

    def close(self) -> None:
        self._dying.clear()
        self._update_lives({})
        self._close_watch()
        self._poll.close()
