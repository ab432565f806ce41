"""The supervisor's side of the port: its own descriptor, a thread that opens a lost port again, and the handover of the
port to the port owner, the stopper and telemetry.

On its own descriptor the supervisor writes the first stop of a run, and any stop that the port owner can't write.

Only the supervisor opens a port. It gives each port that it opens a number. The port owner, the stopper and telemetry
inherit the supervisor's descriptor when they start, or receive it later. If the port is lost, all four processes close
it at once, so they never use different ports.
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
"""How often the thread tries to open a lost port."""
WATCH_S = 1.0
"""How often to list the other devices on this computer while the board is connected, s. If the board is lost later,
failstop takes none of the listed devices for the board."""
DOUBT_S = 0.05
"""How often to look for the real board while the open device may be a different one, s."""
SHARE_NS = 100_000_000
"""How often the supervisor sends the port's descriptor again to a process that could not receive it."""
BUSY_S = 1.0
"""How long to wait for another process to close the port, s. Processes of a dead run may still have it open."""
UDEV_S = 2.0
"""How long to wait at boot until udev lets users open the device file, s. The file may exist before that."""


def outcome(*, written: bool) -> str:
    """Return a clause for people about a stop. `written`: True if the kernel has taken the whole stop."""
    return "the stop is written" if written else "NO STOP COULD BE WRITTEN YET"


class OwnPort(StopPort):
    """The supervisor's own descriptor of the port, `fd`. It is -1 while the port is gone."""

    def __init__(self, fd: int, board: Board, servos: tuple[int, ...] = ()) -> None:
        """`servos`: the ids of the servos in the robot's arm, which is stopped along with the wheels. The ids are not
        known yet when the first burst of a run is written."""
        super().__init__(fd, board, servos)
        self.stopped = False
        """True if the kernel has accepted the complete first burst of the run."""
        self.number = 1
        """The number of the current port. Each time the port is opened again, the number grows by one, so processes can
        tell an old port from the current one."""

    @classmethod
    def open_and_stop(cls, path: str, board: Board, held: Callable[[], None] = lambda: None) -> OwnPort:
        """Open the board's port and write the burst, which is the first thing that a run writes. If another process
        holds the port, retry for BUSY_S, and call `held` before each retry. An error from `held` ends the attempt. If
        udev does not let users open the device file yet, retry for UDEV_S. Raises port.PortError."""
        start_s = monotonic()
        while True:
            # Decide this before opening: otherwise udev could grant access between the refusal and this check.
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
    """True if the device file exists but udev has not given users access to it yet."""
    try:
        node = os.stat(path)
    except OSError:
        return False
    return (node.st_uid, node.st_gid, stat.S_IMODE(node.st_mode)) == (0, 0, 0o600)


class Opener:
    """A thread of the supervisor that opens a lost port as soon as it is back, and writes the burst to it. The
    supervisor's loop must not do this itself, because a slow board may need seconds until its port is open.

    After begin(), only the thread may use `finder`. But the loop may read `finder.at`, `finder.usb`,
    `finder.sure` and `finder.settled`.

    After a loss, the thread may have opened a wrong device for lack of a better one. So it keeps looking for the real
    board. If the board appears, the thread sets `misplaced` and rings the bell.
    """

    def __init__(self, finder: Finder, board: Board, bell: EventBell) -> None:
        """`bell`: the bell that the thread rings when it has opened the port, and when it has set `misplaced`."""
        self._board = board
        self.finder = finder
        self._bell = bell
        self._asked = _thread.allocate_lock()
        self._asked.acquire()
        self._found: tuple[int, int] | None = None
        self.misplaced = False
        self.believed = False
        """True if the open device has answered as the board does. The supervisor's loop sets this, and the thread reads
        it."""
        self._spare = -1
        self._reserve()

    def begin(self) -> None:
        """Start the thread, which then runs as long as the process. Call this before a port is lost, because no thread
        can be started once memory is short."""
        _thread.start_new_thread(self._live, (os.sched_getscheduler(0), os.sched_getparam(0)))

    def look(self) -> None:
        """Make the thread open the lost port as soon as it is back."""
        self._asked.release()

    def pop(self) -> tuple[int, int] | None:
        """Return the port that was opened since the last call, as (descriptor, time of the burst in ns), or None. The
        time is 0 if the burst could not be written."""
        found, self._found = self._found, None
        return found

    def attempt(self) -> bool:
        """Try to open the port once. Returns True if it was opened. Works even if this process has used up all
        descriptor numbers but the reserved one."""
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
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # the main thread handles signals
        # Set the scheduling again: a new thread does not inherit it, because of SCHED_RESET_ON_FORK.
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
    """Hands the port to the port owner, the stopper and telemetry. `controls`: for each process, the supervisor's end
    of the socket to it."""

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
        """False if the open device was opened only because no better one was found, so it may not be the board."""
        return self.opener.finder.sure

    @property
    def where(self) -> tuple[str, str] | None:
        """(path, USB device) of the board's port. None if no port is open, or if the open device may not be the
        board."""
        finder = self.opener.finder
        return (finder.at, finder.usb) if self._port.fd >= 0 and finder.sure else None

    @property
    def misplaced(self) -> bool:
        """True if the open device is not the board, because the board is now connected at another port."""
        return self._port.fd >= 0 and self.opener.misplaced and not self.opener.believed

    def believe(self) -> None:
        """Record that the open device is the board, because it has answered as the board does."""
        if self._port.fd >= 0 and not self.opener.finder.settled:
            self.opener.believed = True

    def lost(self, ready: dict[int, int], now_ns: int) -> bool:
        """If the port is gone, or if the open device is not the board, close the port and let the thread look for the
        board. Returns True if the port was closed."""
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
        """If the thread has opened a lost port again, share it with the other processes. Returns the time when the
        burst was written to the port, or 0 if it was not written. Returns None if no port was opened again."""
        found = self.opener.pop()
        if found is None:
            return None
        fd, written_ns = found
        self._port.adopt(fd)
        self._loop.watch(fd, HANGUP)
        self._share(list(self.controls), now_ns)
        return written_ns

    def log_return(self, now_ns: int, *, written: bool) -> None:
        """Log that the port was opened again. `written`: the kernel has taken the whole stop."""
        path, away_s = self.opener.finder.at, (now_ns - self._lost_ns) / 1e9
        stop = outcome(written=written)
        text = f"{path} is back after {away_s:.1f} s; {stop}"
        if not self.sure:
            proof = ", which proves nothing until it answers" if written else ""
            text = f"{path} may not be the board: a device like it came after {away_s:.1f} s; {stop} to it{proof}"
        if not (written and self.sure):
            text += "; if the wheels turn, use the POWER SWITCH"
        self._events.log("device_back", text, {"path": path, "away_s": round(away_s, 3)})

    def make_up(self, now_ns: int) -> None:
        """Send the port's descriptor again to each process that could not receive it, for example because the process
        had no free descriptor number."""
        if self._port.fd >= 0 and now_ns - self._shared_ns >= SHARE_NS:
            self._share(
                [name for name in self.controls if self._processes[name].running() and not self.has(name)], now_ns
            )

    def _share(self, names: list[str], now_ns: int) -> None:
        """Send the port's descriptor to each of the named processes that has been started. A process that is not
        started yet will inherit the port. A descriptor that was sent to it before its start would stay open in the
        socket's queue."""
        for name in names:
            self._shared_ns = now_ns
            if self._processes[name].pid:
                self.controls[name].send(self._port.fd, self._port.number, self.opener.finder.at)

    def _port_owner_s(self) -> int:
        """What the port owner reports about the current port: whether it has the port open, or has lost it."""
        return records.port_state(self._record.read(), self._port.number)

    def has(self, name: str) -> bool:
        """True if the process `name` (the port owner, the stopper or telemetry) has the current port."""
        if name == layout.PORT_OWNER:
            return self._port_owner_s() == records.PORT_OPEN
        return self._numbers[name].get() == self._port.number

    def complete(self) -> bool:
        """True if the supervisor, the port owner, the stopper and telemetry all have the port. The stopper needs the
        port to stop the robot, and telemetry needs it to prove a stop."""
        return self._port.fd >= 0 and all(map(self.has, self.controls))
