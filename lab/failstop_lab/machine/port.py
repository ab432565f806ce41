"""Port: the board's serial port, as the kernel of the simulated machine has it."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from failstop_lab.machine.epoll import Epoll
from failstop_lab.machine.files import ERR, HUP, IN, OUT, Node, Open

if TYPE_CHECKING:
    from failstop_lab.machine.kernel import Machine


class Port(Node):
    """A serial port as the kernel has it. What is written goes to `board`, unless it does not drain."""

    kind = stat.S_IFCHR
    ROOM = 4096

    def __init__(self, machine: Machine, number: int) -> None:
        super().__init__(0o660)
        self.machine = machine
        self.device = os.makedev(166, number)
        self.came = bytearray()
        self.held = bytearray()
        """Bytes that a port which does not drain keeps."""
        self.drains = True
        self.drained_ns = 0
        """When it has passed on last what it had kept, all at once."""
        self._down, self._up = bytearray(), bytearray()
        """Bytes that a stalled adapter keeps, to the board and from it."""
        self.stalls = False
        """Its adapter passes nothing on. The kernel takes writes and holds nothing, so nobody on this side can tell."""
        self.refuses = False
        """It takes nothing for the moment."""
        self.took_again_ns = 0
        """When it has ended to refuse last."""
        self.gone = False
        self.on_first_open: Callable[[], None] | None = None
        """Called when it is opened for the first time since it was plugged in."""
        self.on_taken: Callable[[bytes], None] = lambda data: None
        """Called with what the kernel takes of each write, before any of it is passed on."""
        self.board: Any = None
        self.settings: list[Any] = [0, 0, 0, 0, 0, 0, [b"\0"] * 32]

    def open(self, opened: Open) -> None:
        if self.gone:
            raise OSError(errno.ENXIO, "no such device")
        if told := self.on_first_open:
            self.on_first_open = None
            told()

    def mask(self, opened: Open) -> int:
        if self.gone:
            return IN | OUT | ERR | HUP
        return (IN if self.came else 0) | (OUT if len(self.held) < self.ROOM and not self.refuses else 0)

    def read(self, opened: Open, most: int) -> bytes:
        if self.gone:
            return b""
        if not self.came:
            raise BlockingIOError(errno.EAGAIN, "nothing has come")
        found = bytes(self.came[:most])
        del self.came[:most]
        return found

    def write(self, opened: Open, data: bytes) -> int:
        if self.gone:
            raise OSError(errno.EIO, "the device is gone")
        taken = bytes(data[: self.ROOM - len(self.held)])
        if not taken or self.refuses:
            raise BlockingIOError(errno.EAGAIN, "full")
        self.on_taken(taken)
        if self.stalls:
            self._down += taken
        elif self.drains:
            self.board.receive(taken)
        else:
            self.held += taken
        return len(taken)

    def stall(self, for_ns: int) -> None:
        """Stall the adapter for so long. Then it passes on all that it has kept in one lump, both ways."""
        self.stalls = True
        self.machine.at(self.machine.now_ns + for_ns, self._go_on)

    def _go_on(self) -> None:
        self.stalls = False
        down, up = bytes(self._down), bytes(self._up)
        self._down.clear()
        self._up.clear()
        if down and not self.gone:
            self.drained_ns = self.machine.now_ns
            self.board.receive(down)
        self.send(up)

    def unsent(self) -> int:
        """The number of bytes that the kernel says it holds."""
        return len(self.held)

    def drain(self) -> None:
        """It takes bytes again."""
        self.drains = True
        if self.held:
            self.drained_ns = self.machine.now_ns
            self.board.receive(bytes(self.held))
            self.held.clear()
            self.notify()

    def send(self, data: bytes) -> None:
        """Bytes of the board."""
        if self.stalls:
            self._up += data
        elif data and not self.gone and self.opened:
            self.came += data[: max(0, self.ROOM - len(self.came))]
            self.notify()

    def accept_again(self) -> None:
        """It refuses nothing any more."""
        if self.refuses:
            self.took_again_ns = self.machine.now_ns
        self.refuses = False
        self.notify()

    def unplug(self, late_ns: Callable[[Epoll], int] = lambda epoll: 0) -> None:
        """The device is gone, for good: a replug is another node. `late_ns`: so much later who waits there hears."""
        self.gone = True
        self.came.clear()
        self.held.clear()
        late = [(epoll, fd) for opened in self.opened for epoll, fd in opened.in_epolls if late_ns(epoll)]
        for epoll, fd in late:
            epoll.hear_late(fd, self.machine, late_ns(epoll))
        self.notify()

    def closed(self, opened: Open) -> None:
        if not self.opened:
            self.came.clear()
            self.held.clear()
