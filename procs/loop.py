"""Loop: waits for descriptors or the next timer, with microsecond time-outs.

A loop waits for every timer that it made; the code that set a timer checks whether it is due. A timer that is due and
is neither taken nor set again keeps the loop awake.

`epoll.poll` takes whole milliseconds; `select` is finer, but can't watch a port for its hang-up alone. So the
descriptors are in an epoll set. For a timer `select` waits for that set; for the longest time that a process may
sleep, where a millisecond is nothing, the set waits by itself, which is a call less. It is one sleep either way: each
costs about 0.12 ms of processor time (60 us of the kernel's, and as much in cold caches).
"""

from __future__ import annotations

import select
from time import monotonic_ns

from failstop.shm.bell import EventBell

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
EDGE = select.EPOLLET
"""Beside READ: tell of new bytes once, whether all of them are read or not."""
HANGUP = 0
"""Watch for the hang-up or error alone, which the kernel always reports."""

GONE = select.EPOLLHUP | select.EPOLLERR
MS = 1_000_000
LONG_NS = 10 * MS
"""A longest time from here on is not meant to the millisecond."""
NEVER = 2**63 - 1


class Timer:
    """A point in time (CLOCK_MONOTONIC ns), or NEVER; and those after it."""

    def __init__(self) -> None:
        self.set(NEVER)

    def set(self, ns: int, *then: int) -> None:
        """Set the next point in time, and those that follow, each when the one before was taken."""
        self.ns, self._then = ns, then

    def due(self, now_ns: int) -> bool:
        """True from that point in time on."""
        return now_ns >= self.ns

    def wait(self, until_ns: int) -> None:
        """Put the next point in time off until then at least."""
        self.ns = max(self.ns, until_ns)

    def take(self, now_ns: int) -> bool:
        """True when the timer is due; the point in time after it takes its place then."""
        if now_ns < self.ns:
            return False
        self.set(*self._then, NEVER)
        return True


class Loop:
    """One process's set of descriptors, and its timers."""

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
        """Watch bells. A wait clears those that have rung: what is news after its end rings again."""
        for bell in bells:
            self._bells[bell.fd] = bell
            self.watch(bell.fd, READ)

    def forget(self, fd: int) -> None:
        """Take a descriptor out; call before closing it, since a duplicate elsewhere would keep it in."""
        self._epoll.unregister(fd)

    def readable(self, fd: int) -> bool:
        """True when a descriptor, in the set or not, can be read now."""
        return bool(select.select((fd,), (), (), 0)[0])

    def timer(self) -> Timer:
        """One more point in time to wait for; for as long as the loop lives."""
        self._timers.append(Timer())
        return self._timers[-1]

    def due_ns(self) -> int:
        """The first of the timers; NEVER: there is none."""
        return min([timer.ns for timer in self._timers], default=NEVER)

    def wait(self, longest_ns: int) -> dict[int, int]:
        """Block until a descriptor is ready, a timer has come, or this time is over; return {fd: what has come}."""
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
