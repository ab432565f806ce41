"""PortHandover: the port's descriptors of supervisor, port owner and stopper, which are one port or none.

The supervisor alone opens a port and numbers it; the others inherit it, or are sent it. All let it go at once when it
has gone.
"""

from __future__ import annotations

from failstop.procs.handover import Control
from failstop.procs.loop import GONE, HANGUP
from failstop.shm import layout, records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.supervisor.opener import Opener
    from failstop.supervisor.port import OwnPort
    from failstop.supervisor.process_table import ProcessTable
    from failstop.supervisor.run import Run

SHARE_NS = 100_000_000
"""How often a process is sent the port until it has it."""


class PortHandover:
    """The supervisor's part of it; `controls`: its ends of the control sockets."""

    def __init__(self, run: Run, port: OwnPort, opener: Opener, processes: ProcessTable) -> None:
        self._port = port
        self.opener = opener
        opener.finder.learn(port.fd)
        self._loop = run.loop
        self._processes = processes
        self._events = run.events
        self._bell = run.resources.bells[layout.STOPPER]
        self._record = run.views[layout.PORT_OWNER].latest_reader("port")
        self._stopper_port = run.views[layout.STOPPER].word("port_number")
        self._shared_ns = self._lost_ns = 0
        self.controls = {process: Control(fds[0]) for process, fds in run.resources.controls.items()}
        run.loop.watch(port.fd, HANGUP)

    def lost(self, ready: dict[int, int], now_ns: int) -> bool:
        """True when the port has just gone: it is let go at once, and looked for."""
        gone = ready.get(self._port.fd, 0) & GONE
        if self._port.fd < 0 or not (gone or self._port_owner_s() == records.PORT_LOST):
            return False
        self._loop.forget(self._port.fd)
        self._port.close()
        self._bell.ring()  # the stopper has the same to let go
        path = self.opener.finder.at
        text = f"{path} is gone; the stop is written the moment it is back; wheels that turn: POWER SWITCH"
        self._events.tell("device_lost", text, {"path": path})
        self._lost_ns = now_ns
        self.opener.look()
        return True

    def opened(self, now_ns: int) -> int | None:
        """When the burst was written (0: it was not) on a port that has just come back; None: none has. It is passed
        on to the others."""
        found = self.opener.take()
        if found is None:
            return None
        fd, written_ns = found
        self._port.adopt(fd)
        self._loop.watch(fd, HANGUP)
        self._share(list(self.controls), now_ns)
        path, away_s = self.opener.finder.at, (now_ns - self._lost_ns) / 1e9
        text = f"{path} is back after {away_s:.1f} s; the stop is written"
        self._events.tell("device_back", text, {"path": path, "away_s": round(away_s, 3)})
        return written_ns

    def make_up(self, now_ns: int) -> None:
        """A descriptor is lost on its way to a process that has no free number for it: it is sent again."""
        if self._port.fd >= 0 and now_ns - self._shared_ns >= SHARE_NS:
            self._share(
                [name for name in self.controls if not self.has(name) and self._processes[name].running()], now_ns
            )

    def _share(self, names: list[str], now_ns: int) -> None:
        """One that is still to be started inherits it, and one in its queue would stay open."""
        for name in names:
            self._shared_ns = now_ns
            if self._processes[name].pid:
                self.controls[name].send(self._port.fd, self._port.number, self.opener.finder.at)

    def _port_owner_s(self) -> int:
        """What the port owner says of the port that is open here."""
        return records.port_state(self._record.read(), self._port.number)

    def has(self, name: str) -> bool:
        """True when port owner or stopper has the port that is open here."""
        if name == layout.PORT_OWNER:
            return self._port_owner_s() == records.PORT_OPEN
        return self._stopper_port.get() == self._port.number

    def complete(self) -> bool:
        """True when all three have the port: without the other two there would be no second channel."""
        return self._port.fd >= 0 and all(map(self.has, self.controls))
