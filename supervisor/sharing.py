"""Sharing: the port's descriptors of supervisor, port owner and stopper, which are one port or none.

The port owner opens a port that comes back and sends it here; from here it goes to the stopper. While no port owner
runs, it is opened here. All let it go at once when it has gone.
"""

from __future__ import annotations

import os
import signal
from time import monotonic_ns

from failstop.board.finder import Finder
from failstop.procs.handover import OPENING_NS, Control
from failstop.procs.loop import GONE, HANGUP, READ
from failstop.shm import layout, records
from failstop.supervisor.device import Device
from failstop.supervisor.fence import Fence
from failstop.supervisor.port import REOPEN_NS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.loop import Loop
    from failstop.shm.segment import Segment
    from failstop.supervisor.events import Events
    from failstop.supervisor.family import Family
    from failstop.supervisor.port import OwnPort
    from failstop.supervisor.resources import Resources

SHARE_NS = 100_000_000
"""How often the stopper is sent the port until it has it."""
KEPT_NS = 500_000_000
"""A port owner that has had a port for this long has sent it in vain."""


class Sharing:
    """The supervisor's part of it; `controls`: its ends of the control sockets."""

    __slots__ = (
        "_bell",
        "_device",
        "_events",
        "_finder",
        "_loop",
        "_port",
        "_port_owner",
        "_record",
        "_shared_ns",
        "_stopper",
        "_stopper_port",
        "controls",
    )

    def __init__(
        self,
        port: OwnPort,
        path: str,
        resources: Resources,
        views: dict[str, Segment],
        loop: Loop,
        family: Family,
        events: Events,
    ) -> None:
        """`path`: where a lost port is looked for first."""
        self._port = port
        self._finder = Finder(path)
        self._finder.learn(port.fd)
        self._loop = loop
        self._events = events
        self._device = Device(events, monotonic_ns())
        self._bell = resources.bells[layout.STOPPER]
        self._port_owner, self._stopper = family[layout.PORT_OWNER], family[layout.STOPPER]
        self._record = views[layout.PORT_OWNER].latest_reader("port")
        self._stopper_port = views[layout.STOPPER].word("port_ns")
        self._shared_ns = 0
        self.controls = {process: Control(fds[0]) for process, fds in resources.controls.items()}
        for control in self.controls.values():
            loop.watch(control.fd, READ)
        loop.watch(port.fd, HANGUP)

    def serve(self, ready: dict[int, int], now_ns: int) -> None:
        """A port that has gone is let go at once; one that the port owner has opened anew is kept and passed on."""
        entry = self._record.read()
        if ready.get(self._port.fd, 0) & GONE or records.lost_since(entry, self._port.since_ns):
            self._let_go()
            self._device.lost(self._finder.at, monotonic_ns())
        self._device.follow(entry)
        if self.controls[layout.PORT_OWNER].fd in ready:
            fd = self.controls[layout.PORT_OWNER].receive()
            if fd >= 0:
                self._let_go()
                self._port.replace(fd)
                self._finder.learn(fd)
                self._loop.watch(fd, HANGUP)
                self._share(now_ns)
        self._make_up(now_ns)

    def _let_go(self) -> None:
        if self._port.fd >= 0:
            self._loop.forget(self._port.fd)
            self._port.replace(-1)
            self._bell.ring()  # it has the same to let go

    def _share(self, now_ns: int) -> None:
        """To the stopper; one that is still to be started inherits it, and one in the queue would stay open."""
        self._shared_ns = now_ns
        if self._stopper.pid:
            self.controls[layout.STOPPER].send(self._port.fd)

    def _is_shared(self) -> bool:
        """True when the stopper has the port that is open here."""
        return self._port.fd >= 0 and self._stopper_port.get() >= self._port.since_ns

    def _make_up(self, now_ns: int) -> None:
        """For a descriptor that was lost on its way, to a process without a free number for it. The stopper is sent it
        again. Here nobody sends it again, and a port that the port owner has can't be opened: so that one is ended as
        soon as there is a number here."""
        if self._port.fd >= 0:
            if now_ns - self._shared_ns >= SHARE_NS and not self._is_shared() and self._stopper.running():
                self._share(now_ns)
        elif self._is_kept(now_ns) and self._has_room():
            os.kill(self._port_owner.pid, signal.SIGKILL)
            self._port_owner.fence = Fence(now_ns, monotonic_ns(), 0)
            text = "the port did not get to the supervisor: port_owner is ended, so that the supervisor can open it"
            self._events.tell("waiting", text, {"for": "the port"})

    def _is_kept(self, now_ns: int) -> bool:
        """True when the port owner has a port that should have been here for a while."""
        opened_ns = self._opened_ns()
        since_ns = max(opened_ns, self._port.since_ns)
        return opened_ns > 0 and now_ns - since_ns >= KEPT_NS and self._port_owner.running()

    def _has_room(self) -> bool:
        try:
            os.close(os.dup(self._bell.fd))
        except OSError:
            return False
        return True

    def _opened_ns(self) -> int:
        """Since when the port owner has the port; 0: it has none."""
        entry = self._record.read()
        _, since_ns, state, _ = records.unpack_port(entry[2]) if entry else (0, 0, records.PORT_CLOSED, "")
        return since_ns if state == records.PORT_OPEN else 0

    def complete(self) -> bool:
        """True when all three have the port: without the other two there would be no second channel."""
        return self._opened_ns() > 0 and self._is_shared()

    def patience_ns(self, now_ns: int) -> int:
        """What the port owner is given beyond its deadline: the time to open a port that is back."""
        if self._port.fd >= 0:
            return 0
        there = self._finder.there()
        return OPENING_NS if self._device.may_be_opened(there, self._port_owner.beat.ns.get(), now_ns) else 0

    def open_alone(self, now_ns: int) -> bool:
        """Open a port that is back and that nobody else would open; True when that was now. A port owner that lives may
        just be opening it, and could not have one that is open here."""
        return not self._port_owner.pid and self._port.reopen(self._finder, now_ns)

    def opened_alone(self, now_ns: int) -> None:
        """What follows the burst on it."""
        self._loop.watch(self._port.fd, HANGUP)
        self._share(now_ns)
        self._device.back(self._finder.at, now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        """When to look for a lost port again; None: that is not for the supervisor to do."""
        return None if self._port.fd >= 0 or self._port_owner.pid else now_ns + REOPEN_NS
