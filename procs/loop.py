"""Loop: waits for descriptors or a point in time, with microsecond time-outs.

`epoll.poll` rounds its time-out up to a millisecond; `select` does not, but can't watch a port for its hang-up alone.
So the descriptors are in an epoll set, and `select` waits for that set.
"""

from __future__ import annotations

import select
from time import monotonic_ns

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
HANGUP = 0
"""Watch for the hang-up or error alone, which the kernel always reports."""

GONE = select.EPOLLHUP | select.EPOLLERR


class Loop:
    """One process's set of descriptors."""

    __slots__ = ("_epoll", "_set")

    def __init__(self) -> None:
        self._epoll = select.epoll()
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
        timeout_s = (until_ns - monotonic_ns()) * 1e-9
        if select.select(self._set, (), (), timeout_s if timeout_s > 0 else 0)[0]:
            return dict(self._epoll.poll(0))
        return {}
