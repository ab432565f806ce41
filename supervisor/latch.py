"""The latch and the epochs. The first stop of a run, and the first one after each reset, is latched: it stays in force
until a person resets it. Each stop also raises a counter, the epoch.

Only the supervisor raises the epoch, latches stops and resets. The other processes read the result. When a stop comes,
the epoch is published last. So if a process sees the new epoch, it also sees which stop is latched, and that the
service is not ready.
"""

from __future__ import annotations

from failstop.messages import layout, records
from failstop.messages.records import CAUSE
from failstop.policy import causes
from failstop.policy.causes import Reply, asked_before
from failstop.shm.words import Barrier
from failstop.supervisor.run import Run
from failstop.supervisor.stops import Stop


class Latch:
    """The latched stop with its epoch, and the newest stop, which may have come later. Pure."""

    def __init__(self) -> None:
        self.stop: Stop | None = None
        """The latched stop, or None."""
        self.since = 0
        """The epoch that was raised for the latched stop; 0 if nothing is latched."""
        self.newest: Stop | None = None
        self.reset_epoch = 0
        """The epoch of the last reset."""
        self._raised_ns = 0

    def add(self, stops: list[Stop], epoch: int, now_ns: int) -> None:
        """Add stops that came at the same time. `epoch`: the new epoch that the supervisor raises for these stops."""
        self.newest = min(stops, key=lambda stop: stop.t_ns)
        self._raised_ns = now_ns
        if self.stop is None:
            self.stop, self.since = self.newest, epoch
        elif better := next((stop for stop in stops if causes.completed(self.stop.cause, stop.cause)), None):
            self.stop.cause = better.cause

    def reset(self, epoch: int, asked_ns: int) -> Reply:
        """Clear the latch. Refuses the reset if a stop has come after the person requested it at `asked_ns`, because
        the person did not know about that stop. A reset does not enable motion."""
        if self.newest and asked_ns < self._raised_ns:
            return asked_before(self.newest.cause)
        self.reset_epoch = epoch
        if self.stop is None:
            return Reply(True, "no stop is latched")
        was, self.stop, self.since = self.stop.cause, None, 0
        return Reply(True, f"latched stop cleared (was: {CAUSE}); motion still disabled", was)

    def as_record(self) -> bytes:
        """The latch as bytes for the record in shared memory. Call this only after the first stop of a run."""
        told = self.stop or self.newest
        assert told is not None
        return records.LATCH.pack(self.since, told.t_ns, self._raised_ns, told.cause.pack())


class Epochs:
    """The words and records in shared memory through which the supervisor publishes the epoch, the latch and the
    replies to reset requests."""

    def __init__(self, run: Run) -> None:
        own, gate = run.own, run.views[layout.GATE]
        self.number = 1
        self.latch = Latch()
        self.owed_ns = 0
        """The time when the oldest owed stop came; 0 if no stop is owed. A stop is owed until the port owner or the
        supervisor has written it."""
        self.ready_word = own.word("ready")
        self._epoch_word = own.word("epoch")
        self._epoch_word.set(self.number)
        self._latch_record = own.latest_writer("latch")
        self._stopped_word = run.views[layout.PORT_OWNER].word("stopped_epoch")
        self._asked_word, self._asked_ns_word = gate.word("resets_asked"), gate.word("reset_asked_ns")
        self._decided_word = own.word("resets")
        self._decided_record = own.latest_writer("reset")
        self._bells = run.bells
        self._barrier = Barrier()

    def raise_for(self, stops: list[Stop], now_ns: int) -> None:
        """Raise the epoch for these stops: publish the cause, then the new epoch, and then ring the bells."""
        self.number += 1
        self.latch.add(stops, self.number, now_ns)
        self._latch_record.write(self.latch.as_record())
        self.ready_word.set(0)
        self._barrier()
        self._epoch_word.set(self.number)
        self._bells[layout.PORT_OWNER].ring()
        self._bells[layout.GATE].ring()
        self.owed_ns = self.owed_ns or now_ns

    def answered(self) -> bool:
        """True if the port owner has written a stop for the current epoch."""
        return self._stopped_word.get() >= self.number

    def decide_reset(self) -> bool:
        """Grant or refuse a new reset request from the gate, if there is one, and publish the reply. Returns True if
        the reset was granted."""
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
