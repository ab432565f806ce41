"""Door: who has the pseudo-terminal open, as far as anybody can see, and how many may."""

from __future__ import annotations

import contextlib
import os
import select

from failstop.guard.openers import Opener, Watch, openers

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.guard.pty import Pty


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

    def look(self, ready: dict[int, int]) -> tuple[list[bool], list[int]]:
        """What has happened since the last look: opens (True) and closes (False) in order, and the pids of programs
        that have died. Cheap, because a stop waits for it."""
        dead = [pid for pid, fd in self._lives.items() if fd in ready]
        return self._watch.events(), dead

    def recount(self, events: list[bool], dead: list[int]) -> str:
        """See who has it open after that, and keep further programs out where it is open as often as may be. Returns
        the program whose child goes on holding it, after which hang_up() helps alone; empty: there is none."""
        seen, hidden = openers(self._pty.name)
        shown = sum(opener.times for opener in seen.values())
        known = max(0, self.count + events.count(True) - events.count(False))
        self.count = max(known, shown) if hidden else shown
        heirs = [self.seen[pid] for pid in dead if pid in self.seen] if seen.keys() - self.seen.keys() else []
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
