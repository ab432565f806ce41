"""Resets: the supervisor decides them, one at a time; the gate passes them on and hears what became of each."""

from __future__ import annotations

from failstop.policy.reply import Reply, unpack
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.gate.clients import Slot
    from failstop.shm.bell import EventBell
    from failstop.shm.segment import Segment

    Asked = tuple[Slot | None, int, int, int]
    """Who asked: its slot (None: the gamepad), its session, the number of its request; and when it was made."""


class Resets:
    """Those that wait; the first of them is being decided."""

    def __init__(self, own: Segment, supervisor: Segment, bell: EventBell) -> None:
        """`bell`: the supervisor's."""
        self._asked_word, self._asked_ns_word = own.word("resets_asked"), own.word("reset_asked_ns")
        self._decided_word, self._record = supervisor.word("resets"), supervisor.latest_reader("reset")
        self._seen = self._decided_word.get()
        self._bell = bell
        self._barrier = Barrier()
        self._waiting: list[Asked] = []

    def ask(self, asked: Asked) -> None:
        """Pass one on, when it is its turn. Of those who ask again before it is, the newest counts: the line is no
        longer than there are slots."""
        self._waiting[1:] = [each for each in self._waiting[1:] if each[0] is not asked[0]]
        self._waiting.append(asked)
        if len(self._waiting) == 1:
            self._pass_on()

    def _pass_on(self) -> None:
        self._asked_ns_word.set(self._waiting[0][3])
        self._barrier()
        self._asked_word.set(self._asked_word.get() + 1)
        self._bell.ring()

    def news(self) -> bool:
        """True when one was decided since the last call, for whomever: the gate before this one may have asked."""
        seen, self._seen = self._seen, self._decided_word.get()
        return self._seen != seen

    def decided(self) -> tuple[Asked, Reply] | None:
        """Who asked for the one that was decided, and what became of it; None: nobody of now."""
        self._barrier()
        entry = self._record.read()
        if not self._waiting or self._seen != self._asked_word.get() or entry is None:
            return None
        asked = self._waiting.pop(0)
        if self._waiting:
            self._pass_on()
        return asked, unpack(entry[2])[2]
