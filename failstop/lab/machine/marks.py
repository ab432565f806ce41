"""Marks: what a campaign of simulated runs must have reached at least once: each cause, each answer of the admission table, each
change of a process's state. What no run has reached was not tried, and is told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from failstop.lab.machine.loading import Loader
    from failstop.lab.machine.witness import Witness


class Marks:
    """How often each was reached."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def reach(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1


def watch(loader: Loader, marks: Marks, witness: Witness) -> None:
    """Have the modules of one machine say what they reach. They decide as without it."""
    _watch_causes(loader, marks, witness)
    _watch_admission(loader, marks)
    _watch_states(loader, marks)


def _watch_causes(loader: Loader, marks: Marks, witness: Witness) -> None:
    epochs = loader.load("failstop.supervisor.latch").Epochs
    raise_for = epochs.raise_for

    def told(self: Any, stops: list[Any], now_ns: int) -> None:
        for stop in stops:
            marks.reach(f"cause {stop.cause.kind.name}")
            witness.causes.append(str(stop.cause))
            witness.tell(f"the supervisor stops: {stop.cause}")
        raise_for(self, stops, now_ns)

    epochs.raise_for = told


def _watch_admission(loader: Loader, marks: Marks) -> None:
    module = loader.load("failstop.procs.port_owner.admission")
    names = {module.WRITE: "write", module.DROP: "drop", module.BURST: "burst", module.REQUEST: "request"}
    decide = module.Admission.decide

    def told(self: Any, *arguments: Any, **words: Any) -> Any:
        found = decide(self, *arguments, **words)
        marks.reach(f"admission {names[found] if isinstance(found, int) else found.kind.name}")
        return found

    module.Admission.decide = told


def _watch_states(loader: Loader, marks: Marks) -> None:
    module = loader.load("failstop.supervisor.children")
    on = module.Child.on
    events = "started runs spared beats killed died reaped given_up recalled".split()

    def told(self: Any, event: int) -> None:
        marks.reach(f"state {self.state} {events[event]}")
        on(self, event)

    module.Child.on = told


def wanted(loader: Loader) -> list[str]:
    """Every mark there is."""
    causes = loader.load("failstop.policy.causes").BY_NAME
    module = loader.load("failstop.supervisor.children")
    events = "started runs spared beats killed died reaped given_up recalled".split()
    found = [f"cause {name}" for name in causes]
    found += [f"admission {name}" for name in ("write", "drop", "burst", "request", "bad frame", "hangs")]
    found += [f"state {state} {events[event]}" for state, row in module.NEXT.items() for event in row]
    return found
