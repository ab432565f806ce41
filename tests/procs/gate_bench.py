"""A gate on the bench: its pure core and a clock that the test moves."""

from __future__ import annotations

from failstop.policy.kinematics import mecanum
from failstop.policy.settings import Settings
from failstop.procs.gate.core import REST, STILL, GateCore
from failstop.procs.gate.sources import Command
from tests.support.why import told

MS = 1_000_000
TICK = 20 * MS
T0 = 100_000 * MS
ROBOT = mecanum(0.08, 0.17706, 0.17165)
Velocity = tuple[float, float, float]


class Gate:
    """A gate and its clock; without the scan gate, which has its own tests."""

    def __init__(self, **changed: float | str) -> None:
        values: dict[str, object] = {key.replace("__", "."): value for key, value in changed.items()}
        self.core = GateCore(Settings({"scan.gate": "off", **values}), ROBOT, T0)
        self.now = T0

    def step(self, elapsed_ns: int = TICK) -> tuple[float, ...] | None:
        self.now += elapsed_ns
        return self.core.step(self.now)

    def take(self, velocity: Velocity, session: int = 1, age_ns: int = 0) -> str:
        fault = self.core.take(Command(session, f"client {session}", self.now - age_ns, velocity), self.now)
        return str(fault or "")

    def drive(self, velocity: Velocity, ticks: int) -> list[Velocity]:
        """A fresh command at every tick; returns the velocity after each."""
        found = []
        for _ in range(ticks):
            assert self.take(velocity) == ""
            self.step()
            found.append(self.core.velocity)
        return found

    def enable(self, epoch: int = 1) -> None:
        assert told(self.core.enable(epoch, "", self.now)) == (True, "motion enabled")

    @property
    def blocked(self) -> str:
        return self.core.blocked(self.now)


def stands(gate: Gate) -> bool:
    """Whether the wheels stop."""
    return gate.core.velocity == REST and gate.core.speeds == STILL
