"""Guarded: a driver program at the guard port, on the simulated machine.

The guard is the service's own code, from its turn (failstop/guard/guard.py) to the client slot under the driver's name.
The machine has no terminals and no inotify, so two parts are stand-ins: a named pipe for the terminal, and a door that
the driver tells when it has opened the pipe, and its pidfd when it has gone. Both programs end with the scenario.
"""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable
from typing import Any

from failstop.messages import layout
from failstop_lab.machine.kernel import SIGKILL
from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import COMMAND_EVERY_S, MS
from failstop_lab.simulate.stage import DRIVER_NS, RPS_PER_MPS, SPEED_MPS, Stage

DRIVER_PIPE = "/run/port"
TURN_S = 0.005
LATE_MS = 340
"""From the driver's end or silence to wheels at rest, whatever is held up: guard.timeout_s, and two ticks."""


class Guarded:
    """The guard and its driver. The player of the scenario goes on saying that its sensor delivers."""

    def __init__(self, stage: Stage, robot: Any) -> None:
        self._stage, self.robot = stage, robot
        self._player = stage.player
        self._system: Any = stage.robot.loader.system["os"]
        with contextlib.suppress(FileExistsError):
            self._system.mkfifo(DRIVER_PIPE)
        board = stage.traits.language
        rps = SPEED_MPS * RPS_PER_MPS
        self.motion, self.rest = board.motor_speeds([rps] * board.wheels, rps), board.burst
        self._asks_rps = max(map(abs, board.speeds(self.motion) or (0.0,)))
        self.driver: Process | None = None
        self.opened: list[Process] = []
        """The drivers that have opened the port, in order; the door takes away those that have gone."""
        self.load = stage.robot.loader.load
        self._drove = False
        """The wheels have turned for the driver."""
        self.guard = stage.robot.program("guard.py", lambda _: self._guard())
        self.start_driver()

    def start_driver(self) -> None:
        """Another one, in the place of the one before."""
        self._drove = False
        self.driver = self._stage.robot.program("bare_driver.py", lambda _: self._drive())

    @property
    def _over(self) -> bool:
        return self._player is None or self._player.dead

    def watch(self, seconds: float) -> None:
        """Let so much time pass."""
        until_s = self._stage.time.monotonic() + seconds
        while self._stage.time.monotonic() < until_s:
            self.robot.sensed()
            self._stage.time.sleep(COMMAND_EVERY_S)

    def moves(self) -> None:
        """Wait until the wheels turn, or would long turn."""
        began_ns = self._stage.machine.now_ns
        while self._stage.witness.moved_ns < began_ns and self._stage.machine.now_ns < began_ns + DRIVER_NS:
            self.watch(COMMAND_EVERY_S)
        self._drove = self._stage.witness.moved_ns >= began_ns

    def kill_driver(self) -> None:
        """SIGKILL, at any moment of its own."""
        if self.driver and self.driver.dead and not self._drove:
            return  # a fault has killed it before it drove, so the next one may drive
        if self.driver:
            self._stage.machine.die(self.driver, -SIGKILL)
        self._stage.must_stop("the driver at the guard port is dead", LATE_MS, layout.GATE)

    def kill_guard(self) -> None:
        """SIGKILL of the guard."""
        self._stage.machine.die(self.guard, -SIGKILL)
        self._stage.must_stop("the guard is dead", 30, layout.GATE)

    def hold(self, process: Process | None, ms: int) -> None:
        """Run nothing of one of the two for so long."""
        if process and not process.dead:
            self._stage.witness.held(process, ms * MS)
            self._stage.machine.hold(process, ms * MS)
            self._stage.must_stop(f"{process.name} is silent", LATE_MS, layout.GATE)

    # The programs.

    def _drive(self) -> None:
        """A driver of the bare board: it writes one frame again and again."""
        port = self._system.open(DRIVER_PIPE, os.O_WRONLY)
        if self.driver:
            self.opened.append(self.driver)
        with contextlib.suppress(BrokenPipeError):
            while not self._over:
                self._stage.witness.asks_for(self._asks_rps)
                self._stage.witness.commands()
                try:
                    self._system.write(port, self.motion)
                except BlockingIOError:
                    pass
                finally:
                    self._stage.witness.commanded()
                self._stage.time.sleep(COMMAND_EVERY_S)
            self._system.write(port, self.rest)

    def _guard(self) -> None:
        """The guard itself, at a port of this machine."""
        load, time = self.load, self._stage.time
        service = load("failstop.guard.service").Service("failstop")
        while not service.look(time.monotonic_ns()):
            time.sleep(TURN_S)
        pty = _Pipe(self._system)
        guard = load("failstop.guard.guard").Guard(service, pty, _Door(self, pty), lambda line: None)
        while not self._over:
            guard.turn()
        guard.close()

    @property
    def system(self) -> Any:
        """The modules of the machine, by name."""
        return self._stage.robot.loader.system


class _Pipe:
    """A named pipe in the place of a terminal (failstop/guard/pty.py). What the guard writes goes nowhere."""

    path = DRIVER_PIPE

    def __init__(self, system: Any) -> None:
        self._system = system
        # Open for both: with no writer the pipe would be ready without end.
        self.master = system.open(DRIVER_PIPE, os.O_RDWR | os.O_NONBLOCK)

    def linked(self) -> bool:
        return True

    def check(self) -> None:
        """Nobody hangs it up."""

    def read(self) -> tuple[bytes, bool]:
        """All that waits; a driver of this machine never writes so much that the rest has to wait."""
        found = b""
        with contextlib.suppress(BlockingIOError):
            while part := self._system.read(self.master, 4096):
                found += part
        return found, True

    def clean(self, *, shared: bool, opened: bool) -> bytes:
        """A pipe has no settings, and one driver at a time."""
        return self.read()[0]

    def write(self, data: bytes) -> bool:
        return True


class _Door:
    """Who has the pipe open (failstop/guard/door.py): the driver says so when it has opened it, and its pidfd when it
    has gone."""

    def __init__(self, guarded: Guarded, pty: _Pipe) -> None:
        self._guarded = guarded
        self._system = guarded.system["os"]
        self._news = guarded.load("failstop.guard.news")
        self._poll = guarded.system["select"].epoll()
        self._poll.register(pty.master, select.EPOLLIN)
        self.most, self.count, self.crowded = 1, 0, False
        self.seen: dict[int, Any] = {}
        self._life = -1

    def wait(self, seconds: float) -> dict[int, int]:
        return dict(self._poll.poll(min(seconds, TURN_S)))

    def look(self, ready: dict[int, int]) -> Any:
        news = self._news.News()
        if self._life in ready:
            self._leave()
            news.ended = news.emptied = news.any = True
        elif not self.count and self._guarded.opened:
            news.any = True
            self.count = 1
        return news

    @property
    def vacant(self) -> bool:
        return not self.count and not self._guarded.opened

    def limit(self) -> None:
        """The drivers of this machine come one after the other."""

    def abandoned(self) -> list[Any]:
        """No driver has a child."""
        return []

    def recount(self, _meanwhile: Callable[[], None]) -> None:
        """See whether the driver that has opened it is still there."""
        if self._guarded.opened and self._life < 0:
            driver = self._guarded.opened[0]
            try:
                self._life = self._system.pidfd_open(driver.pid)
            except ProcessLookupError:
                self._leave()
                return
            self._poll.register(self._life, select.EPOLLIN)
            self.count, self.seen = 1, {driver.pid: self._news.Opener(driver.pid, driver.name, 1)}

    def _leave(self) -> None:
        if self._life >= 0:
            self._poll.unregister(self._life)
            self._system.close(self._life)
        del self._guarded.opened[:1]
        self._life, self.count, self.seen = -1, 0, {}

    def close(self) -> None:
        """Both end with the scenario."""
