"""Requests: from what a client asks for to its reply. A reset is the supervisor's to decide, one at a time; of the rest
what may move something gives way to a stop, and to what ends motion, that was asked for after it."""

from __future__ import annotations

from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.policy.reply import Reply, asked_before, unpack
from failstop.procs.context import Context
from failstop.procs.gate.clients import Slot
from failstop.procs.gate.remarks import Budget, of_request
from failstop.procs.gate.sources import PAD
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.gate.main import Gate

UNSEEN = "another stop has come since: look at it first, then ask again"
NO_ARM = "this robot has no arm: its settings name no joints"
ARM_VERBS = range(records.ARM_MOVE, records.ARM_READ + 1)
ENDS = (records.DISABLE, records.ARM_HOLD)
ARM_MOVES = (records.ARM_MOVE, records.ARM_DRIVE, records.ARM_TUCK)
GIVES_WAY = {records.ENABLE: ENDS, **dict.fromkeys(ARM_MOVES, (*ENDS, *ARM_MOVES, records.ENABLE))}
"""Requests after which something may move, and what each gives way to that was asked for after it and came before it;
and all to a stop."""
Asked = tuple[Slot | None, int, int, int]
"""The asker of a reset: its slot (None: the gamepad), its session, the number of its request; and when it was made."""


class Requests:
    """Requests of clients, the resets that wait, and the answers given."""

    def __init__(self, gate: Gate, context: Context, now_ns: int) -> None:
        own, supervisor = context.own, context.segment("supervisor")
        self._gate = gate
        self._ready_word, self._epoch_word = supervisor.word("ready"), supervisor.word("epoch")
        self._limit_word = own.word("limit")
        gate.core.limit_to(self._limit_word.get() or 100)
        self._asked_ns: dict[int, int] = {}
        """By verb: when what was last done was asked for."""
        self._replies = [own.latest_writer(f"reply.{i}") for i in range(layout.CLIENT_SLOTS)]
        self._replied = [(0, 0)] * layout.CLIENT_SLOTS
        """The session and the number of the last request that was answered there."""
        self._resets: list[Asked] = []
        """Those that wait; the first of them is being decided."""
        self._asked_word, self._asked_ns_word = own.word("resets_asked"), own.word("reset_asked_ns")
        self._decided_word, self._decided = supervisor.word("resets"), supervisor.latest_reader("reset")
        self._resets_seen = self._decided_word.get()
        self._budget = Budget(now_ns)
        self._barrier = Barrier()

    def take(self, slot: Slot, number: int, verb: int, asked_ns: int, now_ns: int) -> None:
        """Decide, act, reply."""
        gate = self._gate
        enabled = gate.core.enabled
        if refused := self._overtaken(slot, verb, asked_ns):
            reply = refused
        elif verb == records.RESET:
            self.ask_reset((slot, slot.session, number, asked_ns))
            return
        elif verb == records.ENABLE:
            reply = self._enable(slot, number, now_ns)
        elif verb == records.DISABLE:
            reply = gate.disable(now_ns)
        elif verb == records.LIMIT:
            _, percent = slot.latest("speed_limit") or (0, 0)
            reply = gate.core.limit_to(percent)
            self._limit_word.set(gate.core.limit)
        elif verb in ARM_VERBS:
            reply = gate.arm.request(slot, number, verb, now_ns) if gate.arm else Reply(False, NO_ARM)
        else:
            reply = Reply(False, f"unknown request {verb}")
        if reply.done:
            self._asked_ns[verb] = max(self._asked_ns.get(verb, 0), min(asked_ns, now_ns))
        self.reply(slot, slot.session, number, reply, now_ns)
        if reply.done != records.UNDER_WAY:
            self._remark(verb, slot, reply, now_ns, enabled=enabled)

    def _newer_than_seen(self, slot: Slot) -> Reply | None:
        """The refusal where the newest stop is not the one that the person knew of. A stop that comes after this look
        is newer than the request, which the supervisor refuses for that."""
        _, seen = slot.latest("seen") or (0, 0)
        return Reply(False, UNSEEN) if seen and seen != self._epoch_word.get() else None

    def _overtaken(self, slot: Slot, verb: int, asked_ns: int) -> Reply | None:
        """The refusal of a reset whose person had not seen the newest stop; and of what would move something, when a
        stop, or something that ends it, was asked for since."""
        if verb == records.RESET:
            return self._newer_than_seen(slot)
        if verb not in GIVES_WAY:
            return None
        if asked_ns < self._gate.raised_ns:
            return asked_before(self._gate.last)
        if any(asked_ns < self._asked_ns.get(each, 0) for each in GIVES_WAY[verb]):
            return Reply(False, "a later request took its place: ask again")
        return None

    def _missing(self) -> str:
        return "" if self._ready_word.get() else "a process or the port is not up yet, see `failstop status`"

    def _enable(self, slot: Slot, number: int, now_ns: int) -> Reply:
        """Motion, if nothing is against it; with an arm that is to be folded, its way to the drive pose first."""
        core, arm = self._gate.core, self._gate.arm
        way = None
        if arm and not core.enabled and not core.refusal(self._missing(), now_ns):
            way = arm.enable(slot, number, now_ns)
        return way or core.enable(self._gate.epoch, self._missing(), now_ns)

    def enable_now(self, slot: Slot, number: int, now_ns: int) -> None:
        """The arm is in the drive pose: enable, if still nothing is against it."""
        reply = self._gate.core.enable(self._gate.epoch, self._missing(), now_ns)
        if reply.done and self._gate.arm:
            self._gate.arm.core.forget()
        self.reply(slot, slot.session, number, reply, now_ns)
        self._remark(records.ENABLE, slot, reply, now_ns)

    def reply(self, slot: Slot, session: int, number: int, reply: Reply, now_ns: int) -> None:
        """Tell a client, once the state that it reads is that of after its request. What a later request of the same
        session has given up is not told of: it would take the place of the answer to that one."""
        last_session, last_number = self._replied[slot.index]
        if session == last_session and number < last_number:
            return
        self._replied[slot.index] = session, number
        self._gate.publish(now_ns)
        self._barrier()
        self._replies[slot.index].write(reply.pack(session, number))

    def _remark(self, verb: int, slot: Slot | None, reply: Reply, now_ns: int, *, enabled: bool = False) -> None:
        """Tell people who has asked for what, with what effect."""
        who, pid = (slot.name, slot.pid) if slot else (PAD, 0)
        note = of_request(verb, who, pid, reply, enabled=enabled)
        if note and self._budget.spend(now_ns):
            self._gate.core.notes.append(note)
            if unsaid := self._budget.unsaid:
                self._budget.unsaid = 0
                self._gate.core.notes.append(Note("note", f"and {unsaid} more requests, too many to tell of each"))

    def ask_reset(self, asked: Asked) -> None:
        """Pass one on, when it is its turn. Of those who ask again before it is, the newest counts: the line is no
        longer than there are slots."""
        self._resets[1:] = [each for each in self._resets[1:] if each[0] is not asked[0]]
        self._resets.append(asked)
        if len(self._resets) == 1:
            self._pass_reset_on()

    def _pass_reset_on(self) -> None:
        self._asked_ns_word.set(self._resets[0][3])
        self._barrier()
        self._asked_word.set(self._asked_word.get() + 1)
        self._gate.supervisor_bell.ring()

    def follow_resets(self, now_ns: int) -> None:
        """Follow the supervisor's decision on a reset, then tell the asker, who may have asked the gate before this
        one."""
        seen, self._resets_seen = self._resets_seen, self._decided_word.get()
        if self._resets_seen == seen:
            return
        self._gate.follow_latch()
        self._barrier()
        entry = self._decided.read()
        if not self._resets or self._resets_seen != self._asked_word.get() or entry is None:
            return
        slot, session, number, _ = self._resets.pop(0)
        if self._resets:
            self._pass_reset_on()
        reply = unpack(entry[2])[2]
        if slot:
            self.reply(slot, session, number, reply, now_ns)
        self._remark(records.RESET, slot, reply, now_ns)
