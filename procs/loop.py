"""Loop: waits for descriptors or a point in time, with microsecond time-outs.

`epoll.poll` takes whole milliseconds; `select` is finer, but can't watch a port for its hang-up alone, and costs a call
more. So the descriptors are in an epoll set, which waits by itself for the whole milliseconds, and `select` waits for
that set for what is left.
"""

from __future__ import annotations

import select
from time import monotonic_ns

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
HANGUP = 0
"""Watch for the hang-up or error alone, which the kernel always reports."""

GONE = select.EPOLLHUP | select.EPOLLERR
MS = 1_000_000


class Loop:
    """One process's set of descriptors."""

    __slots__ = ("_epoll", "_poll", "_set")

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._poll = self._epoll.poll
        self._set = [self._epoll.fileno()]

    def watch(self, fd: int, events: int) -> None:
        """Add a descriptor, or change what it is watched for."""
        try:
            self._epoll.register(fd, events)
        except FileExistsError:
            self._epoll.modify(fd, events)

    def forget(self, fd: int) -> None:
        """Take a descriptor out; call before closing it, since a duplicate elsewhere would keep it in."""
        self._epoll.unregister(fd)

    @staticmethod
    def readable(fd: int) -> bool:
        """True when a descriptor, in the set or not, can be read now."""
        return bool(select.select((fd,), (), (), 0)[0])

    def wait(self, until_ns: int) -> dict[int, int]:
        """Block until a descriptor is ready or CLOCK_MONOTONIC reaches `until_ns`; return {fd: events}."""
        left_ns = until_ns - monotonic_ns()
        if left_ns > MS:
            # Half a millisecond less, which the call rounds up again: the whole milliseconds that are left.
            if ready := self._poll((left_ns // MS - 0.5) * 1e-3):
                return dict(ready)
            left_ns = until_ns - monotonic_ns()
        if select.select(self._set, (), (), left_ns * 1e-9 if left_ns > 0 else 0)[0]:
            return dict(self._poll(0))
        return {}
