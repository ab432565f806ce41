"""Door: who has the pseudo-terminal open, as far as anybody can see, and how many may."""

from __future__ import annotations

import contextlib
import os
import select

from failstop.guard.openers import Opener, Watch, openers

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.guard.pty import Pty


class News:
    """What has happened at the door: who opened and closed it, and who died."""

    def __init__(self, events: Sequence[bool], dead: Sequence[int], count: int) -> None:
        """`events`: opens (True) and closes (False) in order; `dead`: the pids of programs that have died; `count`: how
        often it was open before."""
        self.dead = dead
        self.closed = False
        """Somebody who was known to have it open has closed it. A close for which nobody is known was counted already:
        it came while it was looked who has it open."""
        self.count = count
        """How often it is open now, by this alone."""
        self.any = bool(events or dead)
        for opened in events:
            self.closed |= not opened and self.count > 0
            self.count = self.count + 1 if opened else max(0, self.count - 1)

    @property
    def ended(self) -> bool:
        """A program that had it open has closed it or died."""
        return self.closed or bool(self.dead)


class Door:
    """The programs that have it open. What wakes the guard is registered in `poll`."""

    def __init__(self, pty: Pty, poll: select.epoll) -> None:
        """Raises OSError."""
        self._pty, self._poll = pty, poll
        self.seen: dict[int, Opener] = {}
        """Those that /proc shows, by pid."""
        self.count = 0
        """How often it is open, as far as is known."""
        self.most = 1
        """How often it may be."""
        self._lives: dict[int, int] = {}
        """Of each of those the descriptor that says when it dies."""
        self._begin()

    def _begin(self) -> None:
        self._watch = Watch(self._pty.name)
        for fd in (self._pty.master, self._watch.fd):
            self._poll.register(fd, select.EPOLLIN)

    @property
    def crowded(self) -> bool:
        """More programs have it open than may."""
        return self.count > self.most

    def look(self, ready: dict[int, int]) -> News:
        """What has happened since the last look. Cheap, because a stop waits for it."""
        return News(self._watch.events(), [pid for pid, fd in self._lives.items() if fd in ready], self.count)

    def recount(self, news: News) -> str:
        """See who has it open after that, and keep further programs out where it is open as often as may be. Returns
        the program whose child goes on holding it, after which hang_up() helps alone; empty: there is none."""
        seen, hidden = openers(self._pty.name)
        shown = sum(opener.times for opener in seen.values())
        self.count = max(news.count, shown) if hidden else shown
        # A program that closes it itself has done so before its pidfd tells of its death.
        inherited = not news.closed and seen.keys() - self.seen.keys()
        heirs = [self.seen[pid] for pid in news.dead if pid in self.seen and inherited]
        self._follow(seen)
        self._pty.exclusive(on=self.count >= self.most)
        return str(heirs[0]) if heirs else ""

    def _follow(self, seen: dict[int, Opener]) -> None:
        for pid in self._lives.keys() - seen.keys():
            fd = self._lives.pop(pid)
            self._poll.unregister(fd)
            os.close(fd)
        for pid in seen.keys() - self._lives.keys():
            with contextlib.suppress(OSError):  # it has ended meanwhile, and closed it
                self._lives[pid] = os.pidfd_open(pid)
                self._poll.register(self._lives[pid], select.EPOLLIN)
        self.seen = seen

    def hang_up(self) -> None:
        """Everybody is out. Raises FailstopError, OSError."""
        self._poll.unregister(self._pty.master)
        self._close_watch()
        self._pty.hang_up()
        self._follow({})
        self.count = 0
        self._begin()

    def _close_watch(self) -> None:
        self._poll.unregister(self._watch.fd)
        self._watch.close()

    def close(self) -> None:
        self._follow({})
        self._close_watch()
