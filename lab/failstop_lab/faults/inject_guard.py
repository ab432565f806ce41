"""Injectors: a driver program that knows nothing of failstop, and the guard whose port it has open."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable

from failstop import helpers
from failstop_lab.faults.crowd import Helper
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.inject import Injector
from failstop_lab.faults.scene import Scene
from failstop_lab.trial import COMMAND_EVERY_S

SLOW_RPS = 0.3
ENDS_S = 5.0
SEES_END_S = 0.1
"""The guard has seen by then that a driver ended."""


class PortDriver(Helper):
    """A driver for the bare board: it opens a port by its path and writes one frame again and again. SIGUSR1: it closes
    the port and lives on; SIGTERM: it writes a stop and ends."""

    def __init__(self, path: str, motion: bytes, stop: bytes) -> None:
        self._path, self._motion, self._stop = path, motion, stop
        super().__init__(self._drive)

    def _drive(self) -> None:
        port = os.open(self._path, os.O_RDWR | os.O_NOCTTY)
        closed = ended = False

        def close(*_: object) -> None:
            nonlocal closed
            if not closed:
                closed = True
                os.close(port)

        def end(*_: object) -> None:
            nonlocal ended
            ended = True

        signal.signal(signal.SIGUSR1, close)
        signal.signal(signal.SIGTERM, end)
        while not ended:
            if not closed:
                os.write(port, self._motion)
            time.sleep(COMMAND_EVERY_S)
        if not closed:
            os.write(port, self._stop)

    def leave(self) -> None:
        """Have it end in order, hung or not; nothing if it has been collected."""
        if self.pid:
            for number in (signal.SIGTERM, signal.SIGCONT):
                os.kill(self.pid, number)
            os.waitpid(self.pid, 0)
            self.pid = 0


class Guarded(Injector):
    """A driver at a guard port drives, and the campaign only senses and holds."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._name = ""
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.guard: subprocess.Popen[bytes] | None = None
        self.path = ""
        self.driver: PortDriver | None = None

    def prepare(self, scene: Scene) -> None:
        scene.driver.hand_over()
        self._name = scene.name
        self._folder = tempfile.TemporaryDirectory(prefix="failstop-guard-")
        self.path = os.path.join(self._folder.name, "port")
        self.start_guard()
        scene.driver.until("the guard port", lambda: os.path.exists(self.path))
        self.driver = self.start_driver(scene)

    def start_guard(self) -> None:
        """Start one; its port is there some tenths of a second later."""
        words = helpers.python("failstop", "guard", "--name", self._name, "--path", self.path)
        self.guard = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def start_driver(self, scene: Scene) -> PortDriver:
        """One that drives all wheels alike."""
        board = scene.traits.language
        motion = board.motor_speeds([SLOW_RPS] * board.wheels, SLOW_RPS)
        return PortDriver(self.path, motion, board.burst)

    def heal(self, scene: Scene) -> None:
        if self.driver:
            self.driver.leave()
        if guard := self.guard:
            guard.send_signal(signal.SIGCONT)
            scene.driver.run(SEES_END_S)
            guard.terminate()
            try:
                scene.driver.until("the guard to end", lambda: guard.poll() is not None, ENDS_S)
            finally:
                guard.kill()
                guard.wait()
        if self._folder:
            self._folder.cleanup()
        scene.driver.commands = True


class DriverKilled(Guarded):
    """SIGKILL; at once another one writes to the port, as one does that is started again."""

    SIGNAL = signal.SIGKILL

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._before: PortDriver | None = None

    def strike(self, scene: Scene) -> int:
        assert self.driver
        now_ns = time.monotonic_ns()
        self.driver.signal(self.SIGNAL)
        return now_ns

    def during(self, scene: Scene) -> None:
        if self.driver and self._before is None:
            self._before, self.driver = self.driver, self.start_driver(scene)

    def heal(self, scene: Scene) -> None:
        if self._before:
            self._before.end()
        super().heal(scene)


class DriverCloses(DriverKilled):
    """It closes the port while it drives, and lives on."""

    SIGNAL = signal.SIGUSR1


class GuardKilled(Guarded):
    """SIGKILL; another guard is started, as systemd does, and another driver as soon as its port is there."""

    def strike(self, scene: Scene) -> int:
        assert self.guard
        now_ns = time.monotonic_ns()
        self.guard.kill()
        self.guard.wait()
        os.unlink(self.path)  # its terminal's number may be somebody else's by now
        if self.driver:
            self.driver.end()
            self.driver = None
        self.start_guard()
        return now_ns

    def during(self, scene: Scene) -> None:
        if self.driver is None and os.path.exists(self.path):
            self.driver = self.start_driver(scene)


class DriverHung(Guarded):
    """SIGSTOP of the driver, which goes on afterwards and drives again."""

    def pid(self) -> int:
        """The process that hangs."""
        assert self.driver
        return self.driver.pid

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        os.kill(self.pid(), signal.SIGSTOP)
        return now_ns

    def heal(self, scene: Scene) -> None:
        try:
            if self.driver and self.guard:
                os.kill(self.pid(), signal.SIGCONT)
                scene.driver.until("the wheels to turn by the driver that goes on", scene.trial.turning)
        finally:
            super().heal(scene)


class GuardHung(DriverHung):
    """SIGSTOP of the guard, while the driver writes on."""

    def pid(self) -> int:
        assert self.guard
        return self.guard.pid


INJECTORS: dict[str, Callable[[Fault], Injector]] = {
    "guard-driver-killed": DriverKilled,
    "guard-driver-closes": DriverCloses,
    "guard-driver-hung": DriverHung,
    "guard-killed": GuardKilled,
    "guard-hung": GuardHung,
}
