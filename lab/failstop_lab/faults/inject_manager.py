"""Injectors: a controller manager of ros2_control, which drives through failstop's plugin."""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from failstop.policy.layouts import WHEEL_NAMES
from failstop_lab import controller_manager
from failstop_lab.controller_manager import Manager
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.inject import Injector
from failstop_lab.faults.scene import Scene

NAME = "chaos_base"
RADPS = 2.5


class ManagerEnds(Injector):
    """It gets a signal; as soon as it is gone another program commands, as one does that is started again."""

    SIGNAL = signal.SIGKILL

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.manager: Manager | None = None

    def unfit(self) -> str:
        return controller_manager.uncompilable()

    def prepare(self, scene: Scene) -> None:
        scene.driver.hand_over()
        self._folder = tempfile.TemporaryDirectory(prefix="failstop-manager-")
        wheels = [name.replace(" ", "_") for name in WHEEL_NAMES[scene.traits.language.wheels]]
        description = controller_manager.with_wheels(NAME, scene.name, wheels)
        manager = Manager(controller_manager.NEWEST, description, Path(self._folder.name))
        self.manager = manager.__enter__()
        scene.driver.until("the hardware to be active", lambda: "state active" in manager.said)
        manager.send("claim")
        manager.set({f"{name}/velocity": RADPS for name in manager.joints})

    def strike(self, scene: Scene) -> int:
        assert self.manager
        now_ns = time.monotonic_ns()
        self.manager.signal(self.SIGNAL)
        return now_ns

    def during(self, scene: Scene) -> None:
        assert self.manager
        scene.driver.commands = self.manager.process.poll() is not None

    def heal(self, scene: Scene) -> None:
        if self.manager:
            self.manager.__exit__()
        if self._folder:
            self._folder.cleanup()
        scene.driver.commands = True


class ManagerCrashes(ManagerEnds):
    """SIGSEGV."""

    SIGNAL = signal.SIGSEGV


class ManagerInterrupted(ManagerEnds):
    """SIGINT, as Ctrl-C."""

    SIGNAL = signal.SIGINT


class ManagerHung(ManagerEnds):
    """SIGSTOP. It goes on afterwards and drives again. Then it is ended, which disables motion."""

    SIGNAL = signal.SIGSTOP

    def during(self, scene: Scene) -> None:
        """Nobody else commands."""

    def heal(self, scene: Scene) -> None:
        try:
            if manager := self.manager:
                manager.signal(signal.SIGCONT)
                scene.driver.until("the wheels to turn by the manager that goes on", scene.trial.turning)
        finally:
            super().heal(scene)
        scene.driver.enable()


INJECTORS: dict[str, Callable[[Fault], Injector]] = {
    "manager-killed": ManagerEnds,
    "manager-crashes": ManagerCrashes,
    "manager-interrupted": ManagerInterrupted,
    "manager-hung": ManagerHung,
}
