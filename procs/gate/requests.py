"""Requests of clients. Resets go to the supervisor one at a time. A request that could start motion is refused if
somebody has asked for a stop, a disable or a hold after it was made."""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.policy.causes import Cause, Reply, asked_before, refused, unpack_reply
from failstop.policy.settings import PAD_SOURCE
from failstop.procs.context import Context
from failstop.procs.gate.clients import Slot
from failstop.procs.gate.remarks import Budget, of_request
from failstop.shm.cell import LatestReader
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

UNSEEN = "another stop has come since: look at it first, then ask again"
ENDS = (records.DISABLE, records.ARM_HOLD)
ARM_MOVES = (records.ARM_MOVE, records.ARM_DRIVE, records.ARM_TUCK)
GIVES_WAY = {records.ENABLE: ENDS, **dict.fromkeys(ARM_MOVES, (*ENDS, *ARM_MOVES, records.ENABLE))}
"""For each request after which something may move: the later requests because of which it is refused. A later stop
refuses all of them."""


class Request(Data):
    """A request: its verb, when it was made (CLOCK_MONOTONIC ns), its number, its slot and its session. Without a slot
    it is the gamepad's."""

    verb: int
    asked_ns: int
    number: int = 0
    session: int = records.NOBODY
    slot: Slot | None = None

    @property
    def who(self) -> str:
        return self.slot.who() if self.slot else PAD_SOURCE

    def about(self, record: str) -> tuple[Any, ...] | None:
        """A record of the slot that the request refers to; see Slot.latest()."""
        return self.slot.latest(record) if self.slot else None


class Requests:
    """Decides which requests are refused because of later ones, passes on the resets that wait, and writes the
    answers."""

    def __init__(self, context: Context, notes: list[Note], now_ns: int) -> None:
        """`notes`: the list for notes to people."""
        own, supervisor = context.own, context.segment("supervisor")
        self._notes = notes
        self._supervisor_bell = context.bell("supervisor_bell")
        self._epoch_word = supervisor.word("epoch")
        self._asked_ns: dict[int, int] = {}
        """For each verb: when the newest request that was carried out had been made."""
        self._replies = [own.latest_writer(f"reply.{i}") for i in range(layout.CLIENT_SLOTS)]
        self._replied = [_answered(own.latest_reader(f"reply.{i}")) for i in range(layout.CLIENT_SLOTS)]
        """The session and the number of the last request that was answered in each slot, also by an earlier gate."""
        self._oldest_ns = now_ns - records.ANSWER_WITHIN_NS
        self._answers: list[tuple[int, bytes]] = []
        """Answers that are not written yet, each with its slot."""
        self._resets: list[Request] = []
        """The resets that wait; the first of them is being decided."""
        self._asked_word, self._asked_ns_word = own.word("resets_asked"), own.word("reset_asked_ns")
        self._decided_word, self._decided = supervisor.word("resets"), supervisor.latest_reader("reset")
        self._resets_seen = self._decided_word.get()
        self._budget = Budget(now_ns)
        self._barrier = Barrier()

    def is_answered(self, slot: Slot, number: int) -> bool:
        """True if the request was answered before. A gate that starts finds the newest request of each client, which
        the gate before may have answered."""
        return (slot.session, number) == self._replied[slot.index]

    def refusal(self, request: Request, stopped_ns: int, last: Cause) -> Reply | None:
        """Why the request is refused before anything else is checked, or None. It is refused if it could move something
        and somebody has stopped motion since it was made, if its client no longer waits for an answer, or if it is a
        reset by a person who has not seen the newest stop. `stopped_ns` and `last` describe the last stop."""
        if request.asked_ns < stopped_ns and request.verb in GIVES_WAY:
            return asked_before(last)
        if request.asked_ns < self._oldest_ns:
            return refused("the gate restarted after you asked: ask again")
        if request.verb == records.RESET:
            _, seen = request.about("seen") or (0, 0)
            # A stop that comes after this look is newer than the request, so the supervisor refuses it.
            return refused(UNSEEN) if seen and seen != self._epoch_word.get() else None
        if any(request.asked_ns < self._asked_ns.get(each, 0) for each in GIVES_WAY.get(request.verb, ())):
            return refused("a later request replaced it: ask again")
        return None

    def settle(self, request: Request, reply: Reply, now_ns: int, *, enabled: bool = False) -> None:
        """Answer a request, and note it for people. `enabled`: whether motion was enabled before the request."""
        verb = request.verb
        if reply.done:
            self._asked_ns[verb] = max(self._asked_ns.get(verb, 0), min(request.asked_ns, now_ns))
        self.answer(request, reply)
        if reply.done != records.UNDER_WAY:
            self._remark(request, reply, now_ns, enabled=enabled)

    def answer(self, request: Request, reply: Reply) -> None:
        """Answer a client at the next write(). A request that the session has given up for a later one gets no answer,
        because there is room only for one answer, that of the later one."""
        if (slot := request.slot) is None:
            return
        last_session, last_number = self._replied[slot.index]
        if request.session != last_session or request.number >= last_number:
            self._replied[slot.index] = request.session, request.number
            self._answers.append((slot.index, reply.pack(request.session, request.number)))

    def write(self) -> None:
        """Write the answers after the state that resulted from them. A writer has a barrier before each entry
        (cell.py), so a client that reads an answer never reads an older state."""
        for index, answer in self._answers:
            self._replies[index].write(answer)
        self._answers.clear()

    def _remark(self, request: Request, reply: Reply, now_ns: int, *, enabled: bool) -> None:
        """Note for people which client asked for what, and the effect."""
        who, pid = (request.slot.name, request.slot.pid) if request.slot else (PAD_SOURCE, 0)
        note = of_request(request.verb, who, pid, reply, enabled=enabled)
        if note and self._budget.spend(now_ns):
            self._notes.append(note)
            if unsaid := self._budget.unsaid:
                self._budget.unsaid = 0
                self._notes.append(Note("note", f"and {unsaid} more requests, too many to log each one"))

    def ask_reset(self, request: Request) -> None:
        """Queue a reset; the supervisor gets it when it is its turn. Only the newest reset of each slot waits."""
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
        """True if a reset was decided since the last call. If you read the latch afterwards, it is at least as new as
        that decision, because of the barrier before the decision's entry."""
        seen, self._resets_seen = self._resets_seen, self._decided_word.get()
        return self._resets_seen != seen

    def answer_reset(self, now_ns: int) -> None:
        """Give the client the supervisor's decision. The client may have asked an earlier gate."""
        entry = self._decided.read()
        if not self._resets or self._resets_seen != self._asked_word.get() or entry is None:
            return
        request = self._resets.pop(0)
        if self._resets:
            self._pass_reset_on()
        self.settle(request, unpack_reply(entry[2])[2], now_ns)


def _answered(replies: LatestReader) -> tuple[int, int]:
    """The session and the number of the request to which the newest whole answer belongs; zeros if there is none."""
    entry = replies.read()
    session, number, reply = unpack_reply(entry[2]) if entry else (0, 0, refused(""))
    return (0, 0) if reply.done == records.UNDER_WAY else (session, number)
