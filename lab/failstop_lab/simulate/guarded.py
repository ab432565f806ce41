"""Guarded: a driver program at the guard port, on the simulated machine.

The machine has no terminals and no inotify, so a named pipe stands for the terminal, and the driver's pidfd says when
it has died. What the guard makes of that is the service's own code: the conversation (failstop/guard/talk.py), the
board's language, and the client slot under the driver's name (failstop/guard/service.py). Both programs end with the
scenario.
"""

from __future__ import annotations

import contextlib
import os
import select
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
        self.guard = stage.robot.program("guard.py", lambda _: self._guard())
        self.start_driver()

    def start_driver(self) -> None:
        """Another one, in the place of the one before."""
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

    def kill_driver(self) -> None:
        """SIGKILL, at any moment of its own."""
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
        with contextlib.suppress(BrokenPipeError):
            while not self._over:
                self._stage.witness.asks_for(self._asks_rps)
                with contextlib.suppress(BlockingIOError):
                    self._system.write(port, self.motion)
                self._stage.time.sleep(COMMAND_EVERY_S)
            self._system.write(port, self.rest)

    def _guard(self) -> None:
        """Turns as those of failstop/guard/guard.py: the end of the driver comes before what it wrote."""
        load, time = self._stage.robot.loader.load, self._stage.time
        service = load("failstop.guard.service").Service("failstop")
        port = self._system.open(DRIVER_PIPE, os.O_RDONLY | os.O_NONBLOCK)
        poll = self._stage.robot.loader.system["select"].epoll()
        poll.register(port, select.EPOLLIN)
        driver, life, talk = None, -1, None
        empty_ns = time.monotonic_ns()
        while not self._over:
            ready = {fd for fd, _ in poll.poll(TURN_S)}
            now_ns = time.monotonic_ns()
            service.look(now_ns)
            ended = life in ready
            chunk = self._read(port)
            since_ns, empty_ns = empty_ns, now_ns
            if ended:
                poll.unregister(life)
                self._system.close(life)
                life = -1
                if talk:
                    service.leave(in_order=not talk.ended(chunk, now_ns))
                driver, talk = None, None
                continue
            if not chunk and ready == {port}:
                time.sleep(TURN_S)  # no program has it open
            if driver is None and self.driver and not self.driver.dead:
                driver = self.driver
                with contextlib.suppress(ProcessLookupError):
                    life = self._system.pidfd_open(driver.pid)
                    poll.register(life, select.EPOLLIN)
            if talk is None and chunk and driver and service.settings:
                talk = self._talk(service)
                service.join(driver.name, driver.pid)
            if talk:
                talk.wrote(chunk, now_ns, since_ns)
                if command := talk.command(now_ns):
                    service.command(command)
        service.leave(in_order=True)

    def _read(self, port: int) -> bytes:
        found = b""
        with contextlib.suppress(BlockingIOError):
            while part := self._system.read(port, 4096):
                found += part
        return found

    def _talk(self, service: Any) -> Any:
        load, settings = self._stage.robot.loader.load, service.settings
        language = load("failstop.board.driver").language_of(settings.text("board.kind"), settings.flat())
        _, source_ns = settings.sources()[service.source]
        return load("failstop.guard.talk").Talk(
            language, service.scale.wheels, settings.ns("guard.timeout_s"), source_ns
        )
