"""Lifelines: the news of a process's death as a descriptor that becomes readable, for the same poll as everything else.

A pidfd, which nothing in the watched process can hold back and which no reused pid can confuse. The kernel makes it
readable once the process's memory is torn down, so a watched process is kept small.
"""

from __future__ import annotations

import os
import select


class Lifeline:
    """Watches one process. `fd` becomes readable when the process has died; it then stays readable."""

    __slots__ = ("fd", "pid")

    def __init__(self, pid: int) -> None:
        """Raises ProcessLookupError when there is no such process."""
        self.pid = pid
        self.fd = os.pidfd_open(pid)

    def dead(self) -> bool:
        """True once the process has died. One system call; never blocks."""
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return bool(poll.poll(0))

    def close(self) -> None:
        """Stop watching."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1
