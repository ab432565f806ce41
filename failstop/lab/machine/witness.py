"""Witness: judges a run by what the simulated board executes, against what was done to the machine and asked by its programs.

It never asks the service. A `bar` begins with whatever must stop the wheels, and once its time is over no frame may turn them
before a program asks for motion again.
"""

from __future__ import annotations

from collections.abc import Callable

from failstop.board.framing import MOTOR
from failstop.lab.machine.kernel import Machine, Process
from failstop.lab.sim.model import BoardModel, Frame

MS = 1_000_000
SERVICE = ("supervisor", "port_owner", "gate", "telemetry", "stopper")
DEATH_NS = 3 * MS
"""From a death to the stop at the board: its 600 bytes and the steps of those who write it."""
ASKED_NS = 4 * MS
HANG_NS = {"gate": 85 * MS, "supervisor": 85 * MS, "port_owner": 130 * MS, "stopper": 280 * MS, "telemetry": 530 * MS}
"""From the last beat to the stop at the board: the lease or the deadline, a tick, and the steps."""
TIMEOUT_NS = 570 * MS
"""From the death of a program that drives: its command's timeout and one period of the gate's refresh."""
SLACK_RPS = 1e-3


class Witness:
    """Of one run. `violations` says what was wrong, each once."""

    def __init__(self, machine: Machine, model: BoardModel, max_rps: float) -> None:
        self._machine, self._model = machine, model
        self._max_rps = max_rps
        self.violations: list[str] = []
        self.causes: list[str] = []
        """Names of the causes that were raised, in order."""
        self.story: list[tuple[int, str]] = []
        self.moved_ns = 0
        """When the wheels were told to turn last."""
        self._forbidden = "no program has asked for motion yet"
        """Why no frame may turn the wheels now; empty: one may."""
        self._asked = 0
        machine.told = self._told

    def tell(self, text: str) -> None:
        """One more step of the story."""
        self.story.append((self._machine.now_ns, text))

    def wrong(self, text: str) -> None:
        if text not in self.violations:
            self.violations.append(text)
        self.tell(f"WRONG: {text}")

    # What allows motion, and what forbids it.

    def asks_for_motion(self) -> None:
        """A program calls enable()."""
        self._asked += 1
        self._forbidden = ""
        self.tell("a program asks for motion")

    def must_stop(self, why: str, within_ns: int) -> None:
        """From `within_ns` on the wheels stand, until a program asks for motion again."""
        asked = self._asked
        self.tell(why)

        def due() -> None:
            if self._asked == asked:
                self._forbidden = self._forbidden or why
                if any(self._model.wheels) and self._machine_reaches_board():
                    self.wrong(f"the wheels turn {within_ns / MS:g} ms after: {why}")

        self._machine.at(self._machine.now_ns + within_ns, due)

    def _machine_reaches_board(self) -> bool:
        return self.reaches_board()

    reaches_board: Callable[[], bool] = staticmethod(lambda: True)
    """Whether bytes of the machine come to the board at all: not while it is unplugged."""

    def frame(self, frame: Frame) -> None:
        """The board has executed a frame."""
        if frame.func != MOTOR:
            return
        if any(frame.speeds):
            self.moved_ns = frame.executed_ns
            if self._forbidden:
                self.wrong(f"a frame turns the wheels after: {self._forbidden}")
            if max(map(abs, frame.speeds)) > self._max_rps + SLACK_RPS:
                self.wrong(f"the wheels turn faster than any program asked for: {frame.speeds}")
        if frame.wild:
            self.wrong(f"a frame writes outside of the motors: {frame.wild}")

    # What happens to the machine.

    def _told(self, kind: str, process: Process, what: object) -> None:
        if kind == "failed":
            self.wrong(f"a thread of {process.name} ends with {type(what).__name__}: {what}")
        elif kind == "died":
            self.tell(f"{process.name} (pid {process.pid}) dies: {what}")
            if process.name in SERVICE and not self.orderly:
                self.must_stop(f"{process.name} died", DEATH_NS)
        elif process.name in SERVICE:
            self.tell(f"{process.name} (pid {process.pid}) starts")

    orderly = False
    """The service is ending as it was told to."""

    def held(self, process: Process, ns: int) -> None:
        """A process is not run for so long."""
        if ns > HANG_NS.get(process.name, ns):
            self.must_stop(f"{process.name} is silent", HANG_NS[process.name])
        else:
            self.tell(f"{process.name} is held up for {ns / MS:g} ms")
