"""The whole service on a simulated machine, in front of the board's model; the test is a program beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from failstop.lab.machine.kernel import SIGKILL
from failstop.lab.machine.loading import File
from failstop.lab.machine.robot import Robot

WAITED_S = 20.0
PERIOD_S = 0.02


class Running:
    """A service that is ready, its board, and the test's own `client` of it."""

    def __init__(self, **settings: object) -> None:
        self.robot = Robot(settings=settings)
        self.machine, self.model, self.load = self.robot.machine, self.robot.board.model, self.robot.loader.load
        self.os, self.time = (self.robot.loader.system[name] for name in ("os", "time"))
        self.robot.streams(self.machine.join("test", {"HOME": "/root"}))

    def start(self) -> None:
        """Start the service and be a client of it once it is ready."""
        self.robot.start()
        failstop = self.load("failstop")
        found: list[Any] = []

        def connected() -> bool:
            try:
                found.append(failstop.Robot())
            except failstop.NoService:
                return False
            return True

        self.until("the service", connected)
        (self.client,) = found
        self.client.wait_for("ready", WAITED_S)

    def until(self, what: str, condition: Callable[[], object], limit_s: float = WAITED_S) -> None:
        """Let the machine run until something is so; fails after the limit."""
        end_s = self.time.monotonic() + limit_s
        while not condition():
            assert self.time.monotonic() < end_s, f"not within {limit_s} s: {what}"
            self.time.sleep(0.005)

    def drive(self, seconds: float, speed_mps: float = 0.2) -> None:
        """Enable motion where it is disabled, and command a speed for so long."""
        if not self.client.state.enabled:
            self.client.enable()
        end_s = self.time.monotonic() + seconds
        while self.time.monotonic() < end_s:
            self.client.sensed()
            self.client.drive(speed_mps, 0.0, 0.0)
            self.time.sleep(PERIOD_S)

    def moving(self) -> bool:
        """The board turns a wheel."""
        return any(self.model.wheels)

    def kill(self, name: str) -> None:
        """A process of the service dies by SIGKILL, and the service is ready again with another in its place."""
        dead = self.robot.named(name)
        assert dead is not None
        self.machine.die(dead, -SIGKILL)
        self.until(f"another {name}", lambda: self.client.state.processes[name].pid != dead.pid)
        self.client.wait_for("ready", WAITED_S)

    def said(self) -> str:
        """What the service wrote to its standard error."""
        return b"".join(self.robot.stderr.heard).decode()

    def segment(self, name: str) -> Any:
        """A process's segment, to read."""
        return self.load("failstop.api.client").attach("failstop", name)

    def read_text(self, path: str) -> str:
        """The text of a file of the machine."""
        with File(self.os, path, "r", None) as file:
            return str(file.read())
