"""Requests of clients. Resets go to the supervisor one at a time. A request that could start motion is refused if a
stop, a disable or a hold of the arm came after the request was made."""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.policy.causes import Cause, Reply, asked_before, refused, unpack_reply
from failstop.policy.settings import PAD_SOURCE
from failstop.procs.context import Context
from failstop.procs.gate.clients import Slot
from failstop.procs.gate.remarks import CHANGES, Budget, of_request
from failstop.shm.cell import LatestReader
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

UNSEEN = "another stop has come since: look at it first, then ask again"
ENDS = (records.DISABLE, records.ARM_HOLD)
ARM_MOVES = (records.ARM_MOVE, records.ARM_DRIVE, records.ARM_TUCK)
GIVES_WAY = {records.ENABLE: ENDS, **dict.fromkeys(ARM_MOVES, (*ENDS, *ARM_MOVES, records.ENABLE))}
"""For each kind of request that may start motion, the kinds of later requests that replace it. The gate refuses a
request that was replaced, or that was made before the last stop."""


class Request(Data):
    """A request: what is requested, when it was made (CLOCK_MONOTONIC ns), its number, its session and its slot. A
    request without a slot comes from the gamepad."""

    verb: int
    asked_ns: int
    number: int = 0
    session: int = records.NOBODY
    slot: Slot | None = None

    @property
    def who(self) -> str:
        return self.slot.who() if self.slot else PAD_SOURCE

    def about(self, record: str) -> tuple[Any, ...] | None:
        """Return the newest record that the client has published under this name, like Slot.latest(). None for the
        gamepad, because it has no slot."""
        return self.slot.latest(record) if self.slot else None


class Requests:
    """Refuses outdated requests, passes waiting resets to the supervisor, and writes the replies."""

    def __init__(self, context: Context, notes: list[Note], now_ns: int) -> None:
        """`notes`: the list to which notes for people are added."""
        own, supervisor = context.own, context.segment("supervisor")
        self._notes = notes
        self._supervisor_bell = context.bell("supervisor_bell")
        self._epoch_word = supervisor.word("epoch")
        self._asked_ns: dict[int, int] = {}
        """For each kind of request, the time (Request.asked_ns) of the newest one that was carried out."""
        self._replies = [own.latest_writer(f"reply.{i}") for i in range(layout.CLIENT_SLOTS)]
        self._replied = [_answered(own.latest_reader(f"reply.{i}")) for i in range(layout.CLIENT_SLOTS)]
        """For each slot, the session and number of the last request that was answered, by this gate or an earlier
        one."""
        self._oldest_ns = now_ns - records.ANSWER_WITHIN_NS
        self._answers: list[tuple[int, bytes]] = []
        """Replies that are not written yet, each with the index of its slot."""
        self._resets: list[Request] = []
        """The resets that wait. The supervisor is deciding about the first one."""
        self._asked_word, self._asked_ns_word = own.word("resets_asked"), own.word("reset_asked_ns")
        self._decided_word, self._decided = supervisor.word("resets"), supervisor.latest_reader("reset")
        self._resets_seen = self._decided_word.get()
        self._budgets = {of_change: Budget(now_ns) for of_change in (False, True)}
        """The budget for notes about changes of motion (remarks.CHANGES), and the budget for all other notes. A client
        that repeats another request endlessly must not hide whether motion was enabled since the last stop."""
        self._barrier = Barrier()

    def is_answered(self, slot: Slot, number: int) -> bool:
        """Return True if the request was answered before. A new gate finds each client's newest request again, and the
        previous gate may have answered it."""
        return (slot.session, number) == self._replied[slot.index]

    def refusal(self, request: Request, stopped_ns: int, last: Cause) -> Reply | None:
        """Return the refusal of a request that came too late, or None if the request may be carried out. These are
        refused:

            a request that could start motion, if a stop or a request that replaces it came later
            any request that was made so long before this gate started that its client waits for no reply any more
            a reset, if the person who requests it has not seen the newest stop

        `stopped_ns` and `last`: when the last stop was, and its cause.
        """
        if request.asked_ns < stopped_ns and request.verb in GIVES_WAY:
            return asked_before(last)
        if request.asked_ns < self._oldest_ns:
            return refused("the gate restarted after you asked: ask again")
        if request.verb == records.RESET:
            _, seen = request.about("seen") or (0, 0)
            # If a stop comes after this check, it is newer than the request, so the supervisor refuses the request.
            return refused(UNSEEN) if seen and seen != self._epoch_word.get() else None
        if any(request.asked_ns < self._asked_ns.get(each, 0) for each in GIVES_WAY.get(request.verb, ())):
            return refused("a later request replaced it: ask again")
        return None

    def settle(self, request: Request, reply: Reply, now_ns: int, *, enabled: bool = False) -> None:
        """Reply to a request, and note it for people. `enabled`: True if motion was enabled before the request."""
        verb = request.verb
        if reply.done:
            self._asked_ns[verb] = max(self._asked_ns.get(verb, 0), min(request.asked_ns, now_ns))
        self.answer(request, reply)
        if reply.done != records.UNDER_WAY:
            self._remark(request, reply, now_ns, enabled=enabled)

    def answer(self, request: Request, reply: Reply) -> None:
        """Queue a reply for write(). Drops it if a later request of the same session was answered already, because a
        slot has room for only one reply."""
        if (slot := request.slot) is None:
            return
        last_session, last_number = self._replied[slot.index]
        if request.session != last_session or request.number >= last_number:
            self._replied[slot.index] = request.session, request.number
            self._answers.append((slot.index, reply.pack(request.session, request.number)))

    def write(self) -> None:
        """Write the queued replies. Call this only after the state that results from the requests was published. A
        memory barrier (cell.py) makes sure that a client which has read its reply never reads an older state."""
        for index, answer in self._answers:
            self._replies[index].write(answer)
        self._answers.clear()

    def _remark(self, request: Request, reply: Reply, now_ns: int, *, enabled: bool) -> None:
        """Add a note for people that says which client requested what, and with what result."""
        who, pid = (request.slot.name, request.slot.pid) if request.slot else (PAD_SOURCE, 0)
        note = of_request(request.verb, who, pid, reply, enabled=enabled)
        budget = self._budgets[note is not None and note.kind in CHANGES]
        if note and budget.spend(now_ns):
            self._notes.append(note)
            if unsaid := budget.unsaid:
                budget.unsaid = 0
                self._notes.append(Note("note", f"and {unsaid} more requests, too many to log each one"))

    def ask_reset(self, request: Request) -> None:
        """Queue a reset. The supervisor gets it when all earlier resets are decided. If several resets of one client
        wait, only the newest is kept."""
        self._resets[1:] = [each for each in self._resets[1:] if each.slot is not request.slot]
        self._resets.append(request)
        if len(self._resets) == 1:
            self._pass_reset_on()

    def _pass_reset_on(self) -> None:
        self._asked_ns_word.set(self._resets[0].asked_ns)
        self._barrier()
        self._asked_word.set(self._asked_word.get() + 1)
        self._supervisor_bell.ring()

    def reset_decided(self) -> bool:
        """Return True if the supervisor has decided a reset since the last call. Read the latch only after this call.
        It is then at least as new as the decision, because the supervisor writes the latch, then a memory barrier, and
        then the decision."""
        seen, self._resets_seen = self._resets_seen, self._decided_word.get()
        return self._resets_seen != seen

    def answer_reset(self, now_ns: int) -> None:
        """If the supervisor has decided about the first reset in the queue, reply to the client that requested it, and
        pass the next reset on to the supervisor. A decision for an earlier gate is ignored, because this gate passes
        the client's request on once more."""
        entry = self._decided.read()
        if not self._resets or self._resets_seen != self._asked_word.get() or entry is None:
            return
        request = self._resets.pop(0)
        if self._resets:
            self._pass_reset_on()
        self.settle(request, unpack_reply(entry[2])[2], now_ns)


def _answered(replies: LatestReader) -> tuple[int, int]:
    """Return (session, number) of the request that the newest reply in this record answers. (0, 0) if no reply was
    written, or if it only reports progress."""
    entry = replies.read()
    session, number, reply = unpack_reply(entry[2]) if entry else (0, 0, refused(""))
    return (0, 0) if reply.done == records.UNDER_WAY else (session, number)
