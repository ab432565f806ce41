"""The arm's core on the bench: its servos, and a clock that the test moves from one due time to the next."""

from __future__ import annotations

from collections.abc import Callable

from failstop.board import servos
from failstop.board.rrc import decoder
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.framing import BUS_SERVO
from failstop.policy.settings import Settings
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.core import ArmCore
from failstop.procs.gate.arm.goals import Goal, Trajectory
from failstop_lab.sim.servos import Servos
from tests.support.arm_settings import ARM, SERVOS
from tests.support.gate_scene import Scene

from .gate_bench import MS, T0, TICK, Gate

Make = Callable[..., Scene]
"""A scene with other settings; two underscores are a point."""
SERVO_ANSWER_NS = 2 * MS
"""From a question to its answer."""
ME, OTHER = 11, 12
"""Sessions of clients."""


class ArmBench:
    """The board's servos stand at 500; what each frame of the core asks of them is kept with its time."""

    def __init__(self, **changed: object) -> None:
        values = {key.replace("__", "."): value for key, value in changed.items()}
        self.gate = Gate()
        self.core = ArmCore(Settings({**ARM, **values}), BOARD.arm, T0)
        self.now = T0
        self.servos = Servos(T0, 0)
        self.frames: list[tuple[int, bytes]] = []
        """(when, data) of each."""
        self.holds: list[int] = []
        self._answer: tuple[int, bytes] | None = None

    def step(self) -> None:
        """To the next answer of the board, to when the core asks to go on, or to the next tick of the gate."""
        core = self.core
        if self._answer and self._answer[0] <= min(core.due_ns, self.now + TICK):
            self.now, answer = self._answer
            self._answer = None
            if found := decoder.servo_reply(BUS_SERVO, answer[4:-1]):
                core.answer(*found, self.now)
        else:
            self.now = max(self.now, min(core.due_ns, self.now + TICK))
        self.look()

    def look(self) -> None:
        """A turn of the gate now."""
        frame, hold = self.core.step(self.now)
        assert self.core.due_ns > self.now
        if hold:
            self.holds.append(self.now)
            for servo in SERVOS:
                self.servos.execute(bytes((servos.SERVO_STOP, 1, servo)), self.now)
        if frame:
            self.frames.append((self.now, frame[4:-1]))
            if answer := self.servos.execute(frame[4:-1], self.now):
                self._answer = self.now + SERVO_ANSWER_NS, answer

    def run(self, seconds: float) -> None:
        until_ns = self.now + round(seconds * 1e9)
        while self.now < until_ns:
            self.step()

    def until(self, true: Callable[[], object], most_s: float = 10.0) -> float:
        """Goes on until it is true; how long that took, in seconds."""
        begun_ns = self.now
        while not true():
            assert self.now - begun_ns < most_s * 1e9
            self.step()
        return (self.now - begun_ns) * 1e-9

    def until_moves(self, count: int) -> None:
        """Goes on until so many frames of moves were made."""
        self.until(lambda: len(self.times(servos.SERVO_MOVE)) == count)

    def known(self) -> ArmBench:
        """All of its joints have been read."""
        self.until(lambda: all(joint.known for joint in self.core.joints))
        return self

    def times(self, *commands: int) -> list[int]:
        """When frames with one of these commands were made."""
        return [t_ns for t_ns, data in self.frames if data[0] in commands]

    def goal(self, mode: str = goals.FOLLOW, session: int = ME, rate: float = 0.3, age_ns: int = 0) -> Goal:
        made = Goal(mode, session, f"client {session}", self.now - age_ns, {self.core.joints[0]: rate})
        self.core.accept(made, self.gate.core.arm_closed(), self.now)
        return made

    def execute(self, *rows: tuple[float, float], session: int = ME, joints: int = 1) -> Trajectory:
        """(time, pulses) of the first joints."""
        chosen = self.core.joints[:joints]
        way = [(t_s, dict.fromkeys(chosen, pulses)) for t_s, pulses in rows]
        made = Trajectory(goals.MOVE, session, f"client {session}", chosen, way)
        self.core.execute(made, self.now)
        return made
