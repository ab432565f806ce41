"""The port in the supervisor. The supervisor has its own descriptor, for the first stop of a run and for stops that the
port owner can't write; a thread that opens a lost port again; and the handover to port owner, stopper and telemetry.

The supervisor, the port owner, the stopper and telemetry all hold the same port, or none. Only the supervisor opens a
port and gives it a number; the other three inherit its descriptor or receive it. All four close it at once when the
port is gone.
"""

from __future__ import annotations

import _thread
import os
import signal
import stat
from collections.abc import Callable
from time import monotonic, monotonic_ns, sleep

from failstop.board import port
from failstop.board.finder import Finder
from failstop.board.stop_port import StopPort
from failstop.messages import layout, records
from failstop.procs.handover import Control
from failstop.procs.loop import GONE, HANGUP

TYPE_CHECKING = False
if TYPE_CHECKING:  # `failstop run` imports OwnPort before its first stop, and needs nothing more
    from failstop.board.interface import Board
    from failstop.shm.bell import EventBell
    from failstop.supervisor.process_table import ProcessTable
    from failstop.supervisor.run import Run

LOOK_NS = 5_000_000
"""How often to look for a lost port."""
WATCH_S = 1.0
"""How often to list the devices next to the board, s. After a loss, none of them can be the board."""
DOUBT_S = 0.05
"""How often to look for the board while the open device may not be the board, s."""
SHARE_NS = 100_000_000
"""How often to send the port to a process until it has it."""
BUSY_S = 1.0
"""How long to wait for a port that the processes of a dead run are still closing, s."""
UDEV_S = 2.0
"""How long udev may take at boot to make an existing device accessible to its users, s."""


class OwnPort(StopPort):
    """The supervisor's own descriptor of the port; -1 while the port is gone."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        """`servos`: the ids of the robot's arm, which is stopped with the wheels; unknown at the first burst of a
        run."""
        super().__init__(fd, board, servos)
        self.stopped = False
        """True if the kernel has accepted the whole first burst of the run."""
        self.number = 1
        """How many ports this run has had, which names this one among the processes that share it."""

    @classmethod
    def open_and_stop(cls, path: str, board: Board, held: Callable[[], None] = lambda: None) -> OwnPort:
        """Open the board's port and write the burst, the first bytes of a run. While another process holds the port,
        `held` is called, and may raise. Raises port.PortError."""
        start_s = monotonic()
        while True:
            # Look before opening: the rights may arrive between a refusal and the look.
            patience_s = {"busy": BUSY_S, "permission": UDEV_S if _is_new(path) else 0.0}
            try:
                own = cls(port.open_port(path, exclusive=True, line=board.port), board)
            except port.PortError as error:
                if monotonic() - start_s > patience_s.get(error.kind, 0.0):
                    raise
                if error.kind == "busy":
                    held()
                sleep(0.005)
            else:
                own.stopped = own.burst()
                return own

    def adopt(self, fd: int) -> None:
        super().adopt(fd)
        self.number += fd >= 0


def _is_new(path: str) -> bool:
    """True while udev has not yet made a new device accessible to its users."""
    try:
        node = os.stat(path)
    except OSError:
        return False
    return (node.st_uid, node.st_gid, stat.S_IMODE(node.st_mode)) == (0, 0, 0o600)


class Opener:
    """A thread of the supervisor that opens a lost port when it is back, and writes the burst on it.

    Opening a board that is slow to wake up may take seconds, so a thread does it and the supervisor's loop goes on. The
    thread also writes the burst, so the burst doesn't wait for the loop. Once begin() was called, only the thread uses
    `finder`, except for `at`, `sure` and `settled`.

    While the port is open, the thread lists the devices. If the open one was taken for the board only because no better
    one was found, and the board appears, it sets `misplaced` and rings the bell.
    """

    def __init__(self, finder: Finder, board: Board, bell: EventBell) -> None:
        """`bell` rings when the port is open."""
        self._board = board
        self.finder = finder
        self._bell = bell
        self._asked = _thread.allocate_lock()
        self._asked.acquire()
        self._found: tuple[int, int] | None = None
        self.misplaced = False
        self.believed = False
        """True if the open device has answered as the board does. Set by the loop, read by the thread."""
        self._spare = -1
        self._reserve()

    def begin(self) -> None:
        """Start the thread, which lives as long as the process. After a loss it may be too late to get one."""
        _thread.start_new_thread(self._live, (os.sched_getscheduler(0), os.sched_getparam(0)))

    def look(self) -> None:
        """Make the thread open the lost port as soon as it is back."""
        self._asked.release()

    def pop(self) -> tuple[int, int] | None:
        """Return the opened port, once: its descriptor, and when the burst on it was written (0: it was not)."""
        found, self._found = self._found, None
        return found

    def attempt(self) -> bool:
        """Look for the port once. A descriptor number was reserved for it, because by then none may be free."""
        if self._spare >= 0:
            os.close(self._spare)
        self.misplaced = self.believed = False
        fd = self.finder.open(monotonic_ns())
        if fd >= 0:
            written = StopPort(fd, self._board).burst()
            self._found = (fd, monotonic_ns() if written else 0)
            self._bell.ring()
        self._reserve()
        return fd >= 0

    def _reserve(self) -> None:
        try:
            self._spare = os.dup(self._bell.fd)
        except OSError:
            self._spare = -1

    def _live(self, policy: int, priority: os.sched_param) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # these are for the loop
        # A thread does not inherit what SCHED_RESET_ON_FORK takes away.
        os.sched_setscheduler(0, policy, priority)
        self.finder.look_around()
        while True:
            if not self._asked.acquire(timeout=WATCH_S if self.finder.settled else DOUBT_S):
                self._watch()
                continue
            while not self.attempt():
                sleep(LOOK_NS / 1e9)

    def _watch(self) -> None:
        if self.believed:
            self.believed = False
            self.finder.believe()
        self.finder.look_around()
        if not self.misplaced and self.finder.misplaced():
            self.misplaced = True
            self._bell.ring()


class PortHandover:
    """The supervisor's side of the handover. `controls`: its ends of the control sockets."""

    def __init__(self, run: Run, port: OwnPort, processes: ProcessTable) -> None:
        self._port = port
        finder = Finder(run.settings.text("device.path"), port.board.port)
        self.opener = Opener(finder, port.board, run.bells[layout.SUPERVISOR])
        self.opener.finder.learn(port.fd)
        self._loop = run.loop
        self._processes = processes
        self._events = run.events
        self._bells = run.bells[layout.STOPPER], run.bells[layout.TELEMETRY]
        self._record = run.views[layout.PORT_OWNER].latest_reader("port")
        self._numbers = {name: run.views[name].word("port_number") for name in (layout.STOPPER, layout.TELEMETRY)}
        self._shared_ns = self._lost_ns = 0
        self.controls = {process: Control(fds[0]) for process, fds in run.controls.items()}
        run.loop.watch(port.fd, HANGUP)

    @property
    def sure(self) -> bool:
        """False while the open device was accepted as the board only because no better one was found."""
        return self.opener.finder.sure

    @property
    def misplaced(self) -> bool:
        """True if the open device is not the board, although the board is present."""
        return self._port.fd >= 0 and self.opener.misplaced and not self.opener.believed

    def believe(self) -> None:
        """Record that the open device answered as the board does, so it is the board."""
        if self._port.fd >= 0 and not self.opener.finder.settled:
            self.opener.believed = True

    def lost(self, ready: dict[int, int], now_ns: int) -> bool:
        """True if the port has just been lost, or the open device is not the board. The device is closed at once, and
        the thread looks for the board."""
        if self._port.fd < 0:
            return False
        gone = ready.get(self._port.fd, 0) & GONE or self._port_owner_s() == records.PORT_LOST
        if not gone and not self.misplaced:
            return False
        self._loop.forget(self._port.fd)
        self._port.close()
        for each in self._bells:
            each.ring()  # the others must close it too
        path = self.opener.finder.at
        text = f"{path} is gone; the stop is written the moment it is back; if the wheels turn, use the POWER SWITCH"
        if not gone:
            text = f"{path} is not the board, which is at another port now; the stop is written there at once"
        self._events.log("device_lost", text, {"path": path})
        self._lost_ns = now_ns
        self.opener.look()
        return True

    def opened(self, now_ns: int) -> int | None:
        """Share a port that has just come back, and return when its burst was written (0: it was not). None: no port
        has come back."""
        found = self.opener.pop()
        if found is None:
            return None
        fd, written_ns = found
        self._port.adopt(fd)
        self._loop.watch(fd, HANGUP)
        self._share(list(self.controls), now_ns)
        path, away_s = self.opener.finder.at, (now_ns - self._lost_ns) / 1e9
        text = f"{path} is back after {away_s:.1f} s; the stop is written"
        if not self.sure:
            text = (
                f"{path} may not be the board: a device like it came after {away_s:.1f} s; the stop is written to it, "
                "which proves nothing until it answers; if the wheels turn, use the POWER SWITCH"
            )
        self._events.log("device_back", text, {"path": path, "away_s": round(away_s, 3)})
        return written_ns

    def make_up(self, now_ns: int) -> None:
        """Send the descriptor again to a process that could not receive it, because it had no free descriptor
        number."""
        if self._port.fd >= 0 and now_ns - self._shared_ns >= SHARE_NS:
            self._share(
                [name for name in self.controls if self._processes[name].running() and not self.has(name)], now_ns
            )

    def _share(self, names: list[str], now_ns: int) -> None:
        """Share the port with a process that runs. A process that is not started yet inherits the port; if it were
        sent, a descriptor in its queue would stay open."""
        for name in names:
            self._shared_ns = now_ns
            if self._processes[name].pid:
                self.controls[name].send(self._port.fd, self._port.number, self.opener.finder.at)

    def _port_owner_s(self) -> int:
        """What the port owner reports about the port that is open here."""
        return records.port_state(self._record.read(), self._port.number)

    def has(self, name: str) -> bool:
        """True if the port owner, the stopper or telemetry has the port that is open here."""
        if name == layout.PORT_OWNER:
            return self._port_owner_s() == records.PORT_OPEN
        return self._numbers[name].get() == self._port.number

    def complete(self) -> bool:
        """True when all four processes have the port: otherwise there would be no second channel, or no proof."""
        return self._port.fd >= 0 and all(map(self.has, self.controls))
