"""Loop: waits for descriptors or the next timer, with microsecond time-outs.

A loop waits for every timer that it made; the code that set a timer checks whether it is due. A timer that is due and
neither taken nor set again keeps the loop awake.

`epoll.poll` takes whole milliseconds. `select` is finer, but can't watch a port for its hang-up alone. So the
descriptors are in an epoll set, and `select` waits for that set when a timer is near. When only the longest sleep
limits the wait, a millisecond doesn't matter, so the set waits by itself, which saves a call. Either way a wait is one
sleep, which costs about 0.12 ms of processor time (60 us in the kernel, and as much in cold caches).
"""

from __future__ import annotations

import select
from time import monotonic_ns

from failstop.shm.bell import EventBell

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
EDGE = select.EPOLLET
"""Together with READ: report new bytes only once, even if they are not read."""
HANGUP = 0
"""Watch only for the hang-up or an error, which the kernel always reports."""

GONE = select.EPOLLHUP | select.EPOLLERR
MS = 1_000_000
LONG_NS = 10 * MS
"""A wait that is longer than this need not be exact to the millisecond."""
NEVER = 2**63 - 1


class Timer:
    """A timer: the next point in time (CLOCK_MONOTONIC ns), or NEVER, and the points that follow it."""

    def __init__(self) -> None:
        self.set(NEVER)

    def set(self, ns: int, *then: int) -> None:
        """Set the next point in time, and the ones that follow it. Each of these takes effect when pop() has returned
        True for the one before."""
        self.ns, self._then = ns, then

    def due(self, now_ns: int) -> bool:
        """True from the next point in time on."""
        return now_ns >= self.ns

    def wait(self, until_ns: int) -> None:
        """Put the next point in time off, so that it is not before `until_ns`."""
        self.ns = max(self.ns, until_ns)

    def pop(self, now_ns: int) -> bool:
        """True if the timer is due. Then the following point in time becomes the next one."""
        if now_ns < self.ns:
            return False
        self.set(*self._then, NEVER)
        return True


class Loop:
    """The descriptors and timers that one process waits for."""

    def __init__(self) -> None:
        self._timers: list[Timer] = []
        self._bells: dict[int, EventBell] = {}
        self._epoll = select.epoll()
        self._poll = self._epoll.poll
        self._set = [self._epoll.fileno()]

    def watch(self, fd: int, wanted: int) -> None:
        """Add a descriptor, or change what it is watched for."""
        try:
            self._epoll.register(fd, wanted)
        except FileExistsError:
            self._epoll.modify(fd, wanted)

    def listen(self, *bells: EventBell) -> None:
        """Watch bells. A wait clears the bells that have rung, so news after the wait rings again."""
        for bell in bells:
            self._bells[bell.fd] = bell
            self.watch(bell.fd, READ)

    def forget(self, fd: int) -> None:
        """Remove a descriptor. Call it before closing, since a duplicate elsewhere would keep it in the set."""
        self._epoll.unregister(fd)

    def readable(self, fd: int) -> bool:
        """True when a descriptor, in the set or not, can be read now."""
        return bool(select.select((fd,), (), (), 0)[0])

    def timer(self) -> Timer:
        """Make a timer that this loop waits for as long as it lives."""
        self._timers.append(Timer())
        return self._timers[-1]

    def due_ns(self) -> int:
        """The first time of all timers; NEVER if none is set."""
        return min([timer.ns for timer in self._timers], default=NEVER)

    def wait(self, longest_ns: int) -> dict[int, int]:
        """Wait until a descriptor is ready, a timer is due, or `longest_ns` is over. Returns {fd: its events}."""
        left_ns = self.due_ns() - monotonic_ns()
        if LONG_NS <= longest_ns < left_ns - MS:
            found = dict(self._poll(longest_ns * 1e-9))
        else:
            left_ns = min(left_ns, longest_ns)
            come = left_ns <= 0 or select.select(self._set, (), (), left_ns * 1e-9)[0]
            found = dict(self._poll(0)) if come else {}
        for fd in self._bells.keys() & found:
            self._bells[fd].clear()
        return found
