"""The stop pipe, which everyone may write to. Any bytes are a stop; the text, if there is one, only says why.

After a request the pipe rests, because a flood of requests must not become a flood of bursts and epochs. Bytes that
arrive meanwhile stay in the pipe, and no motion is admitted before they were read.
"""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import NEVER, READ, Loop
from failstop.shm import bell

REST_NS = 20_000_000


class RequestPipe:
    """The port owner's end of the pipe."""

    def __init__(self, fd: int, loop: Loop) -> None:
        self._fd, self._loop = fd, loop
        self._rests = loop.timer()
        """When the pause after a request ends."""
        loop.watch(fd, READ)

    def asked(self, ready: dict[int, int], now_ns: int) -> bool:
        """True when a stop is requested at this wake-up."""
        if self._fd in ready:
            return True
        if self._rests.due(now_ns):
            self.wake()
        return False

    def waits(self) -> bool:
        """True when a request waits while the pipe rests."""
        return self._rests.ns != NEVER and self._loop.readable(self._fd)

    def accept(self, now_ns: int) -> Cause:
        """Read the request, once its stop is written; the pipe rests from now on."""
        line = bell.receive(self._fd).split(b"\n", 1)[0]
        if self._rests.ns == NEVER:
            self._loop.forget(self._fd)
        self._rests.set(now_ns + REST_NS)
        return causes.requested(line)

    def wake(self) -> None:
        """End the rest: the next request counts at once."""
        if self._rests.ns != NEVER:
            self._rests.set(NEVER)
            self._loop.watch(self._fd, READ)
