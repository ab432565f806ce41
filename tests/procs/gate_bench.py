"""A gate on the bench: its pure core and a clock that the test moves."""

from __future__ import annotations

from failstop.messages.records import BY_HAND
from failstop.policy import kinematics
from failstop.policy.settings import Settings
from failstop.procs.gate.core import REST, GateCore
from failstop.procs.gate.sources import Command
from tests.support.why import told

MS = 1_000_000
TICK = 20 * MS
T0 = 100_000 * MS
ROBOT = kinematics.from_settings(Settings())
NO_SPEEDS = (0.0,) * 4
Velocity = tuple[float, float, float]


class Gate:
    """A gate and its clock; without the scan gate, where a test does not switch it on."""

    def __init__(self, **changed: object) -> None:
        values = {key.replace("__", "."): value for key, value in changed.items()}
        self.core = GateCore(Settings({"scan.gate": "off", **values}), ROBOT, T0)
        self.now = T0

    def step(self, elapsed_ns: int = TICK) -> tuple[float, ...] | None:
        self.now += elapsed_ns
        self.core.check_interlocks(self.now)
        self.silence = self.core.driver_silence(self.now)
        return self.core.step(self.now)

    def tick(self, elapsed_ns: int = TICK) -> float:
        """The speed forward after a step."""
        self.step(elapsed_ns)
        return self.core.velocity[0]

    def accept(
        self,
        velocity: Velocity,
        session: int = 1,
        age_ns: int = 0,
        *,
        source: str = "cmd_vel",
        manual: bool = False,
        flags: int = 0,
    ) -> str:
        who, t_ns = f"client {session}", self.now - age_ns
        flags |= BY_HAND if manual else 0
        return str(self.core.accept(Command(session, who, t_ns, velocity, source, flags), self.now) or "")

    def command(self, vx: float, source: str = "cmd_vel", session: int = 1, *, manual: bool = False) -> str:
        return self.accept((vx, 0.0, 0.0), session, source=source, manual=manual)

    def drive(self, velocity: Velocity, ticks: int) -> list[Velocity]:
        """A fresh command at every tick; returns the velocity after each."""
        found = []
        for _ in range(ticks):
            assert self.accept(velocity) == ""
            self.step()
            found.append(self.core.velocity)
        return found

    def enable(self, epoch: int = 1) -> None:
        assert told(self.core.enable(epoch, "", self.now)) == (True, "motion enabled")

    def gone(self, session: int = 1, *, parted: bool = False) -> object:
        """A client has left, or died; the cause of a stop for it."""
        return self.core.client_gone(session, self.now, parted=parted)

    def told(self) -> list[str]:
        """Notes for people, in words."""
        return [note.text for note in self.core.notes]

    @property
    def blocked(self) -> str:
        return self.core.blocked(self.now)


def stands(gate: Gate) -> bool:
    """Whether the wheels stop."""
    return gate.core.velocity == REST and gate.core.speeds == NO_SPEEDS
