"""The stop pipe. Every user may write to it, and any bytes in it request a stop. If the bytes are text, the text is
logged as the reason.

After a request, the pipe rests: the port owner does not watch it for REST_NS, so that a flood of requests does not
become a flood of bursts and epochs. Requests that arrive during the rest stay in the pipe, and no motion is admitted
until they have been read.
"""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import NEVER, READ, Loop
from failstop.shm import bell

REST_NS = 20_000_000


class RequestPipe:
    """The port owner's end of the stop pipe."""

    def __init__(self, fd: int, loop: Loop) -> None:
        self._fd, self._loop = fd, loop
        self._rests = loop.timer()
        """A timer that is due when the pipe's rest is over. It is NEVER while the pipe does not rest."""
        loop.watch(fd, READ)

    def asked(self, ready: dict[int, int], now_ns: int) -> bool:
        """Return True if a stop request has woken the port owner. If the pipe's rest is over, watch the pipe again."""
        if self._fd in ready:
            return True
        if self._rests.due(now_ns):
            self.wake()
        return False

    def waits(self) -> bool:
        """Return True if the pipe rests and another request already waits in it."""
        return self._rests.ns != NEVER and self._loop.readable(self._fd)

    def accept(self, now_ns: int) -> Cause:
        """Read all requests that wait in the pipe, and return the cause of the stop, with the first line as the reason.
        Call it after the stop was written. The pipe's rest begins now."""
        line = bell.receive(self._fd).split(b"\n", 1)[0]
        if self._rests.ns == NEVER:
            self._loop.forget(self._fd)
        self._rests.set(now_ns + REST_NS)
        return causes.requested(line)

    def wake(self) -> None:
        """End the rest, so that the next request is noticed at once."""
        if self._rests.ns != NEVER:
            self._rests.set(NEVER)
            self._loop.watch(self._fd, READ)
