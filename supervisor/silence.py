"""Silence: who was silent past its deadline and is excused, since the machine did not run it; and what people are told.

A stop is right whatever the reason, a kill is not: what was not run is run again, and a process that is restarted on
a machine that starves it is silent again. While motion is disabled there is nothing to stop.

    motion    starved: port owner    starved: another             hangs
    enabled   stopped, killed        stopped, latched             stopped, killed, latched
    disabled  told                   told                         stopped, killed, latched

Whoever is starved beyond starved.LONGEST_NS is killed too, but its death counts for no crash loop.
"""

from __future__ import annotations

import msgpack

from failstop.shm import layout
from failstop.shm.barrier import Barrier
from failstop.supervisor.children import Child
from failstop.supervisor.run import Run

TELL_EVERY_NS = 10_000_000_000


class Silence:
    """What the supervisor knows of motion when it judges a silence, and the silences that it has excused."""

    def __init__(self, run: Run, advice: str) -> None:
        """`advice`: what to do against it, for people."""
        self._gate_record = run.views[layout.GATE].latest_reader("state")
        self._moving_word = run.views[layout.PORT_OWNER].word("moving")
        self._barrier = Barrier()
        self._starved = run.world.starved
        self._bells = run.bells
        self._events = run.events
        self._advice = advice
        self._told_ns = 0
        self.times = 0
        self.longest_ms = 0
        self.process = ""
        """The one that was silent for longest."""

    def motion(self, epoch: int) -> bool:
        """True while motion is enabled in this epoch, or the wheels were last told to turn. Read after whatever it is
        to be compared with: the port owner says that it moves before it looks at the epoch for the last time."""
        self._barrier()
        if self._moving_word.get():
            return True
        entry = self._gate_record.read()
        gate = msgpack.unpackb(entry[2]) if entry else {}
        return bool(gate.get("enabled")) and gate["epoch"] == epoch

    def starved(self, child: Child) -> bool:
        """True when the machine did not run this silent process."""
        return self._starved(child.pid, child.beat, child.allowed_ns(), self._bells[child.row.name])

    def follow(self, children: list[Child], now_ns: int) -> None:
        """Once a turn: who was excused and has beaten again is told of."""
        for child in children:
            if silent_ns := child.beaten():
                self.over(child.row.name, silent_ns, now_ns)

    def over(self, name: str, silent_ns: int, now_ns: int) -> None:
        """A process was not run for so long; told at once, then at most every ten seconds."""
        self.times += 1
        silent_ms = round(silent_ns / 1e6)
        if silent_ms > self.longest_ms:
            self.longest_ms, self.process = silent_ms, name
        if self._told_ns and now_ns - self._told_ns < TELL_EVERY_NS:
            return
        self._told_ns = now_ns
        text = f"the machine starves the service: {name} was not run for {silent_ms} ms; {self._advice}"
        self._events.tell("starved", text, {"process": name, "silent_ms": silent_ms, "times": self.times})

    def as_record(self) -> dict[str, int | str] | None:
        """For the process table; None: nobody was starved in this run."""
        if not self.times:
            return None
        return {"times": self.times, "longest_ms": self.longest_ms, "process": self.process}
