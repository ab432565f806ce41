"""Every injector, by the name that the rows call it."""

from __future__ import annotations

from failstop_lab.faults import inject_board, inject_clients, inject_guard, inject_machine, inject_manager, ptrace
from failstop_lab.faults.fault import SPIN, Fault
from failstop_lab.faults.inject import Injector
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.steps import Steps


class Processes(Injector):
    """Inject the row's steps."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._pids: dict[str, int] = {}
        self._steps: Steps | None = None

    def unfit(self) -> str:
        return ptrace.unfit() if self.fault.struck(SPIN) else ""

    def prepare(self, scene: Scene) -> None:
        self._pids = scene.service.pids()
        self._steps = Steps(self.fault, scene.chance)

    def strike(self, scene: Scene) -> int:
        assert self._steps
        fault_ns = self._steps.perform(self._pids, scene.driver.run)
        if self.fault.stop_tool:
            scene.start_stop_tool()
        return fault_ns

    def heal(self, scene: Scene) -> None:
        if self._steps:
            self._steps.undo(self._pids)


INJECTORS = {
    "processes": Processes,
    **inject_board.INJECTORS,
    **inject_clients.INJECTORS,
    **inject_guard.INJECTORS,
    **inject_machine.INJECTORS,
    **inject_manager.INJECTORS,
}


def injector(fault: Fault) -> Injector:
    """The row's injector. Raises KeyError when there is none."""
    return INJECTORS[fault.injector](fault)
