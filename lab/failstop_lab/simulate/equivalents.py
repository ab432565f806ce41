"""Equivalents: a fault at one call that is the same as at another, because nothing on the machine can tell them apart.
Such a run is counted but not played. The rules are exact: tests/lab/machine/test_equivalents.py plays both of a
sample."""

from __future__ import annotations

from failstop_lab.machine.files import Node
from failstop_lab.machine.process import Thread
from failstop_lab.simulate.faults import stop_pipe
from failstop_lab.simulate.stage import Stage

SLEEPS, ASKS, IS_HELD, IS_STARVED = "machine sleeps", "somebody asks for a stop", "held", "starved"


class Equivalents:
    """The faults that were tried last, and everything that could have noticed each of them since.

    - The machine sleeps: a look at a clock that goes on meanwhile.
    - Somebody asks for a stop: a look at the stop pipe, another thread that goes on, or other news for a waiting
      thread, which would come in another order.
    - A process is starved: the same as held at the same call, except for a process that asks why it is silent.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage, self._machine = stage, stage.machine
        self._noticed: dict[str, tuple[object, ...]] = {}
        self.why_asked = True
        """In the run with the last held process, another process asked why it is silent."""

    def tried(self, fault: str, thread: Thread) -> bool:
        """Whether this fault at this call was tried before."""
        if fault == IS_STARVED:
            return not self.why_asked
        noticed = self._noticed_by(fault, thread)
        before, self._noticed[fault] = self._noticed.get(fault, ()), noticed
        return bool(noticed) and before == noticed

    def _noticed_by(self, fault: str, thread: Thread) -> tuple[object, ...]:
        since_asked = self._stage.witness.asked_for_motion
        if fault == SLEEPS:
            return since_asked, self._machine.sleep_looks
        if fault == ASKS and (pipe := stop_pipe(self._stage)):
            others = self._machine.switches, len(self._machine.runnable), Node.news
            return since_asked, thread.number, *others, pipe.number, pipe.looks
        return ()
