"""Epochs: the number that the supervisor alone raises, what is latched with it, and the resets that clear that.

Whoever sees a new epoch, with its bell or without, finds the cause of it and a service that is not ready.
"""

from __future__ import annotations

from failstop.shm import layout
from failstop.shm.words import Barrier
from failstop.supervisor.latch import Latch

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.supervisor.run import Run
    from failstop.supervisor.stops import Stop


class Epochs:
    """The words and records of shared memory that the latch is told in."""

    def __init__(self, run: Run) -> None:
        own, gate = run.own, run.views[layout.GATE]
        self.number = 1
        self.latch = Latch()
        self.ready_word = own.word("ready")
        self._epoch_word = own.word("epoch")
        self._epoch_word.set(self.number)
        self._latch_record = own.latest_writer("latch")
        self._stopped_word = run.views[layout.PORT_OWNER].word("stopped_epoch")
        self._asked_word, self._asked_ns_word = gate.word("resets_asked"), gate.word("reset_asked_ns")
        self._decided_word = own.word("resets")
        self._decided_record = own.latest_writer("reset")
        self._bells = run.resources.bells
        self._barrier = Barrier()

    def raise_for(self, stops: list[Stop], now_ns: int) -> None:
        """The cause first, then the epoch that refers to it, then the bells."""
        self.number += 1
        self.latch.add(stops, self.number, now_ns)
        self._latch_record.write(self.latch.as_record())
        self.ready_word.set(0)
        self._barrier()
        self._epoch_word.set(self.number)
        self._bells[layout.PORT_OWNER].ring()
        self._bells[layout.GATE].ring()

    def answered(self) -> bool:
        """True when the port owner has answered this epoch with a stop."""
        return self._stopped_word.get() >= self.number

    def decide_reset(self) -> bool:
        """Decide the reset that the gate passes on, and tell it; True when one was done."""
        number = self._asked_word.get()
        if number == self._decided_word.get():
            return False
        self._barrier()
        reply = self.latch.reset(self.number, self._asked_ns_word.get())
        if reply.done and reply.cause:
            self._latch_record.write(self.latch.as_record())
        self._decided_record.write(reply.pack(0, number))
        self._barrier()
        self._decided_word.set(number)
        self._bells[layout.GATE].ring()
        return bool(reply.done)
