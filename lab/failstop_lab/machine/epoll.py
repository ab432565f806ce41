"""Epoll: the descriptors that a process of a simulated machine waits for, and which of them may be ready."""

from __future__ import annotations

from typing import TYPE_CHECKING

from failstop_lab.machine.files import ERR, HUP, IN, Node, Open

if TYPE_CHECKING:
    from failstop_lab.machine.kernel import Machine

EDGE_TRIGGERED = 1 << 31


class Epoll(Node):
    """A set of descriptors of one process, with those that may be ready."""

    kind = 0

    def __init__(self) -> None:
        super().__init__()
        self.wanted: dict[int, tuple[Open, int]] = {}
        self.maybe: dict[int, None] = {}
        self.late: dict[int, tuple[Open, int]] = {}
        """Descriptors that are heard of again later."""

    def add(self, fd: int, opened: Open, events: int) -> None:
        if fd not in self.wanted:
            opened.in_epolls.append((self, fd))
        self.wanted[fd] = (opened, events)
        self.mark(fd)

    def drop(self, fd: int) -> None:
        if self.late.pop(fd, None):
            return
        opened, _ = self.wanted.pop(fd)
        self.maybe.pop(fd, None)
        opened.in_epolls.remove((self, fd))

    def mark(self, fd: int) -> None:
        Node.news += 1
        self.maybe[fd] = None
        self.notify()

    def hear_late(self, fd: int, machine: Machine, ns: int) -> None:
        """News of this descriptor comes so much later."""
        watched = self.wanted[fd]
        self.drop(fd)

        def hear() -> None:
            if fd in self.late:
                del self.late[fd]
                self.add(fd, *watched)

        self.late[fd] = watched
        machine.at(machine.now_ns + ns, hear)

    def pop_ready(self) -> list[tuple[int, int]]:
        """Descriptors that are ready; one that is watched for its edge alone is told of once."""
        Node.news += 1
        found = []
        for fd in tuple(self.maybe):
            opened, events = self.wanted[fd]
            mask = opened.mask() & (events & 0xFFFF | ERR | HUP)
            if not mask or events & EDGE_TRIGGERED:
                del self.maybe[fd]
            if mask:
                found.append((fd, mask))
        return found

    def mask(self, opened: Open) -> int:
        Node.news += 1
        for fd in tuple(self.maybe):
            held, events = self.wanted[fd]
            if held.mask() & (events & 0xFFFF | ERR | HUP):
                return IN
            del self.maybe[fd]
        return 0

    def closed(self, opened: Open) -> None:
        for fd in tuple(self.wanted):
            self.drop(fd)
