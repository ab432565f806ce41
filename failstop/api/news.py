"""News: a wake-up for whoever reads the service's state and events, without a right to anything of it.

The supervisor writes one byte of the file that names its run once more; inotify tells whoever watches that file, and
tells them too when a run ends or another one takes the name. What watching costs the writer is bounded by the kernel:
a user has 128 watches of one file at most (fs.inotify.max_user_instances). A wake-up that is lost costs a look later.
"""

from __future__ import annotations

import ctypes
import errno
import os
import select

from failstop.shm import instance

_MODIFY, _ATTRIB, _MOVE_SELF, _DELETE_SELF, _GONE = 0x2, 0x4, 0x800, 0x400, 0x8000
_DONT_FOLLOW = 0x02000000
_WATCHED = _MODIFY | _ATTRIB | _MOVE_SELF | _DELETE_SELF | _DONT_FOLLOW
_MOST_BYTES = 65536


class News:
    """A descriptor that is readable when there may be news of an instance. Not for several threads at once."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fd: int = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        """-1 where this user may have no more of them: then there are no wake-ups, and looking is all there is."""
        self._watched = False

    def watch(self) -> bool:
        """Watch the run that is there; True when it is watched already. Look after it: what was told before it wakes
        nobody."""
        if self._watched or self.fd < 0:
            return self._watched
        for path in instance.places(self._name):
            found = self._libc.inotify_add_watch(self.fd, os.fsencode(instance.run_path(path)), _WATCHED)
            if found >= 0:
                self._watched = True
                break
            if ctypes.get_errno() == errno.ENOSPC:
                break
        return False

    def clear(self) -> None:
        """Take the wake-ups so far; call before looking."""
        try:
            told = os.read(self.fd, _MOST_BYTES) if self.fd >= 0 else b""
        except BlockingIOError:
            return
        at = 0
        while at + 16 <= len(told):
            mask = int.from_bytes(told[at + 4 : at + 8], "little")
            self._watched = self._watched and not mask & ~_MODIFY
            at += 16 + int.from_bytes(told[at + 12 : at + 16], "little")

    def look(self) -> None:
        """Before a look at what there may be news of: whatever is told after this wakes whoever waits."""
        self.clear()
        self.watch()

    def wait(self, timeout_s: float) -> None:
        """Sleep until there may be news."""
        poll = select.poll()
        if self.fd >= 0:
            poll.register(self.fd, select.POLLIN)
        poll.poll(max(0.0, timeout_s) * 1e3)

    def close(self) -> None:
        """Give the descriptor back."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)
