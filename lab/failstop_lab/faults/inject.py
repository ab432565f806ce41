"""Injectors: each makes one kind of fault happen, with real signals and real bytes, and undoes what it can."""

from __future__ import annotations

import time

from failstop_lab.faults.fault import Fault
from failstop_lab.faults.scene import Scene

TROUBLE_S = 0.2
ASKED_MEANWHILE = "asked meanwhile"


class Injector:
    """One fault: prepare() while all is well, strike() while the wheels turn, heal() when its time is over."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault

    def unfit(self) -> str:
        """Why it can't be done here; empty when it can."""
        return ""

    def prepare(self, scene: Scene) -> None:
        """Before the drive that the fault ends."""

    def strike(self, scene: Scene) -> int:
        """Make it happen; returns the moment that times are taken from (CLOCK_MONOTONIC ns)."""
        raise NotImplementedError

    def during(self, scene: Scene) -> None:
        """With every command while the fault lasts."""

    def heal(self, scene: Scene) -> None:
        """Undo what is not the service's to undo; also after a strike that failed."""


class AskedMeanwhile(Injector):
    """A trouble that the wheels must turn through, and that a stop request must get through."""

    def trouble(self, scene: Scene) -> None:
        """Begin."""
        raise NotImplementedError

    def last(self, scene: Scene) -> None:
        """Drive through it for a while."""
        until_s = time.monotonic() + TROUBLE_S
        while time.monotonic() < until_s:
            self.during(scene)
            scene.driver.run(0.02)

    def strike(self, scene: Scene) -> int:
        self.trouble(scene)
        self.last(scene)
        scene.was_turning = scene.trial.turning()
        scene.board.events()
        now_ns = time.monotonic_ns()
        scene.ask(ASKED_MEANWHILE)
        return now_ns
