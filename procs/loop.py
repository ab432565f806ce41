"""Loop: waits for descriptors or for the next timer, with time-outs exact to the microsecond.

A due timer wakes the loop. The code that has set the timer must then pop it or set it again. Until it does, the loop
does not sleep.

`epoll.poll` can only wait for whole milliseconds. `select` is more exact, but it can't watch a port for its hang-up
alone. So the descriptors are in an epoll set, and `select` waits for that set while a timer is near. Otherwise the
epoll set waits by itself, which saves a call. Each wait costs about 0.12 ms of processor time (60 us in the kernel, and
as much because of cold caches).
"""

from __future__ import annotations

import select
from time import monotonic_ns

from failstop.shm.bell import EventBell

READ = select.EPOLLIN
WRITE = select.EPOLLOUT
EDGE = select.EPOLLET
"""Used with READ. New bytes are then reported only once, even if nobody reads them."""
HANGUP = 0
"""Watch only for a hang-up or an error. The kernel always reports these."""

GONE = select.EPOLLHUP | select.EPOLLERR
MS = 1_000_000
LONG_NS = 10 * MS
"""A sleep of at least this length, in ns, may take a millisecond longer if no timer is due before its end."""
NEVER = 2**63 - 1


class Timer:
    """A timer. It has a next point in time (CLOCK_MONOTONIC ns, or NEVER) and may have more points that follow."""

    def __init__(self) -> None:
        self.set(NEVER)

    def set(self, ns: int, *then: int) -> None:
        """Set the next point in time, and the points that follow it. Each successful pop() moves on to the following
        point."""
        self.ns, self._then = ns, then

    def due(self, now_ns: int) -> bool:
        """Return True once the next point in time has been reached."""
        return now_ns >= self.ns

    def wait(self, until_ns: int) -> None:
        """Postpone the next point in time if it is before `until_ns`."""
        self.ns = max(self.ns, until_ns)

    def pop(self, now_ns: int) -> bool:
        """If the timer is due, move on to the following point in time and return True. Otherwise return False."""
        if now_ns < self.ns:
            return False
        self.set(*self._then, NEVER)
        return True


class Loop:
    """Waits for the descriptors and timers of one process."""

    def __init__(self) -> None:
        self._timers: list[Timer] = []
        self._bells: dict[int, EventBell] = {}
        self._epoll = select.epoll()
        self._poll = self._epoll.poll
        self._set = [self._epoll.fileno()]

    def watch(self, fd: int, wanted: int) -> None:
        """Add a descriptor, or change the events that it is watched for."""
        try:
            self._epoll.register(fd, wanted)
        except FileExistsError:
            self._epoll.modify(fd, wanted)

    def listen(self, *bells: EventBell) -> None:
        """Watch bells. wait() clears each bell that has rung, so that a later ring wakes the loop again."""
        for bell in bells:
            self._bells[bell.fd] = bell
            self.watch(bell.fd, READ)

    def forget(self, fd: int) -> None:
        """Stop watching a descriptor. Call this before you close it, because the epoll set keeps it while another
        process has a duplicate."""
        self._epoll.unregister(fd)

    def readable(self, fd: int) -> bool:
        """Return True if the descriptor can be read now. It need not be watched."""
        return bool(select.select((fd,), (), (), 0)[0])

    def timer(self) -> Timer:
        """Make a timer. The loop waits for it as long as the loop exists."""
        self._timers.append(Timer())
        return self._timers[-1]

    def due_ns(self) -> int:
        """Return the earliest point in time of all timers, or NEVER if none is set."""
        return min([timer.ns for timer in self._timers], default=NEVER)

    def wait(self, longest_ns: int) -> dict[int, int]:
        """Wait until a descriptor is ready, a timer is due, or `longest_ns` is over. Returns the ready descriptors as
        {fd: its events}."""
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
