"""The stop pipe, to which everybody may write: any bytes are a stop, and the text, where there is one, only says why.

After a request the pipe rests: a flood of requests must not become a flood of bursts and epochs. Bytes that arrive
meanwhile stay in the pipe, and no motion is admitted before they have been looked at.
"""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import NEVER, READ, Loop
from failstop.shm import bell

REST_NS = 20_000_000


class RequestPipe:
    """The port owner's end of it."""

    def __init__(self, fd: int, loop: Loop) -> None:
        self._fd, self._loop = fd, loop
        self._rests = loop.timer()
        """Until then, after a request."""
        loop.watch(fd, READ)

    def asked(self, ready: dict[int, int], now_ns: int) -> bool:
        """True when somebody asks for a stop at this wake-up."""
        if self._fd in ready:
            return True
        if self._rests.due(now_ns):
            self.wake()
        return False

    def waits(self) -> bool:
        """True when a request waits while the pipe rests."""
        return self._rests.ns != NEVER and self._loop.readable(self._fd)

    def take(self, now_ns: int) -> Cause:
        """The request, once its stop is written; from here on the pipe rests."""
        line = bell.take(self._fd).split(b"\n", 1)[0]
        if self._rests.ns == NEVER:
            self._loop.forget(self._fd)
        self._rests.set(now_ns + REST_NS)
        return causes.requested(line)

    def wake(self) -> None:
        """The next request counts at once."""
        if self._rests.ns != NEVER:
            self._rests.set(NEVER)
            self._loop.watch(self._fd, READ)
