"""Injectors: each makes one kind of fault happen, with real signals and real bytes, and undoes what it can."""

from __future__ import annotations

import time
from collections.abc import Callable

from failstop.lab.faults import ptrace
from failstop.lab.faults.fault import SPIN, Fault
from failstop.lab.faults.scene import Scene
from failstop.lab.faults.steps import Steps

TROUBLE_S = 0.2
ASKED = "asked meanwhile"


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
        scene.was_moving = scene.trial.moving()
        scene.board.events()
        now_ns = time.monotonic_ns()
        scene.ask(ASKED)
        return now_ns


class Processes(Injector):
    """What the row's steps say."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._pids: dict[str, int] = {}
        self._steps: Steps | None = None

    def unfit(self) -> str:
        return ptrace.unfit() if self.fault.struck(SPIN) else ""

    def prepare(self, scene: Scene) -> None:
        self._pids = scene.look_up_pids()
        self._steps = Steps(self.fault, scene.chance)

    def strike(self, scene: Scene) -> int:
        assert self._steps
        fault_ns = self._steps.take(self._pids, scene.driver.run)
        if self.fault.stop_tool:
            scene.start_stop_tool()
        return fault_ns

    def heal(self, scene: Scene) -> None:
        if self._steps:
            self._steps.undo(self._pids)


Registry = dict[str, Callable[[Fault], Injector]]


def _all() -> Registry:
    from failstop.lab.faults import inject_board, inject_clients, inject_machine

    found: Registry = {"processes": Processes}
    for module in (inject_board, inject_clients, inject_machine):
        found.update(module.INJECTORS)
    return found


def injector(fault: Fault) -> Injector:
    """The row's injector. Raises KeyError when there is none."""
    return _all()[fault.injector](fault)


def names() -> set[str]:
    """Every injector."""
    return set(_all())
