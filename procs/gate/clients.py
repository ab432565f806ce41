"""Clients, as the gate sees them: which slots are claimed, what is new in them, and which clients have gone.

The gate reads everything with pread and believes it only when its CRC, its claim and its session agree. A client's name
and pid are its own claims, for people to read; nothing depends on their truth.
"""

from __future__ import annotations

from collections.abc import Iterator

from failstop.messages import layout, records
from failstop.procs.gate.sources import Command
from failstop.procs.loop import READ, Loop
from failstop.shm import claim
from failstop.shm.cell import Entry, LatestReader
from failstop.shm.lifeline import EarlyNews, Lifeline, pid_namespace
from failstop.shm.segment import Segment

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

News = tuple["Slot", str, tuple[object, ...]]
"""A slot with a session; then the name of one of its records, with the record's time (ns) and values, or OVER."""
OVER = "gone"
"""The name of the news that a session has ended. Its value is True if the session said goodbye."""
ONCE = ("command", "request", "arm_goal", "aux")
"""Records that are acted on only once, when they are new."""


def newest_number(reader: LatestReader) -> int:
    """The number of the newest entry. Entries from before a restart of the gate are not new, because the gate before
    may have acted on them."""
    entry = reader.read()
    return entry[0] if entry else 0


class Slot:
    """One client slot, and the session that holds it; session 0 means that nobody holds it."""

    def __init__(self, index: int, segment: Segment) -> None:
        self.index = index
        self.segment = segment
        self.pid = 0
        self.pid_namespace = 0
        self.name = ""
        self._hello, self._left = segment.latest_reader("hello"), segment.latest_reader("left")
        self._greeting: Entry | None = None
        self._greeted: int | None = None
        """The last hello that was read, and its session."""
        self._readers = {name: segment.latest_reader(name) for name in records.OF_SESSION}
        # The gate's own record says which request was answered (requests.py).
        self._seen = {name: 0 if name == "request" else newest_number(self._readers[name]) for name in ONCE}
        self._session_seen = self.greet()
        self.ended = 0
        """The session that held the slot before. Its records no longer count."""
        self.life: Lifeline | None = None
        self.session = 0

    def who(self) -> str:
        return f"{self.name} (pid {self.pid})"

    def greet(self) -> int | None:
        """The session whose hello is in the slot now; None if there is no hello, or it is damaged."""
        entry = self._hello.read()
        if entry is not self._greeting:
            self._greeting, self._greeted = entry, None
            try:
                if entry:
                    self._greeted, self.pid, self.pid_namespace, name = records.HELLO.unpack(entry[2])
                    self.name = bounded(name, records.WHO_BYTES)
            except ValueError:
                return None
        return self._greeted

    def parted(self) -> bool:
        """True when the session that holds the slot has said goodbye."""
        entry = self._left.read()
        try:
            return entry is not None and self.session in records.LEFT.unpack(entry[2])
        except ValueError:
            return False

    def join(self, session: int) -> None:
        """Let a session hold the slot. The records of a new session are read from the start."""
        if session != self._session_seen:
            self._seen = dict.fromkeys(ONCE, 0)
        self.session = self._session_seen = session

    def latest(self, name: str) -> tuple[Any, ...] | None:
        """The time (ns) and values of the newest record of this name, if it is whole and of this session."""
        return self._believed(records.OF_SESSION[name], self._readers[name].read())

    def new(self, name: str) -> tuple[Any, ...] | None:
        """The newest record of this name, unless it was returned before."""
        entry = self._readers[name].read()
        if entry is None or entry[0] == self._seen[name]:
            return None
        self._seen[name] = entry[0]
        return self._believed(records.OF_SESSION[name], entry)

    def _believed(self, shape: records.Shape, entry: Entry | None) -> tuple[Any, ...] | None:
        if entry is None:
            return None
        try:
            writer, *values = shape.unpack(entry[2])
        except ValueError:
            return None
        return (entry[1], *values) if writer == self.session else None

    def command(self, t_ns: int, vx: float, vy: float, wz: float, manual: bool, source: str) -> Command:
        """A command of this session with these values."""
        return Command(self.session, self.who(), t_ns, (vx, vy, wz), manual=manual, source=source)

    def said(self) -> tuple[int, str, str] | None:
        """The session's last report for people: when it came, what the program sees, what is wrong; None if there is
        none."""
        if found := self.latest("said"):
            t_ns, sees, wrong = found
            return t_ns, bounded(sees, records.SAID_BYTES), bounded(wrong, records.SAID_BYTES)
        return None


def bounded(text: str, room: int) -> str:
    """A client's text, cut so that the record has room for the texts of all clients. Unprintable characters are
    replaced, because each would take three bytes."""
    return records.cut(records.printable(text), room).decode()


class ClientTable:
    """All client slots; `active` are those that a session holds. Act on each news before you ask for the next one."""

    def __init__(
        self, segments: list[Segment], claims_fd: int, loop: Loop, early: EarlyNews, heard: tuple[str, ...]
    ) -> None:
        """`heard`: the records to read, in this order."""
        self._claims_fd = claims_fd
        self._loop = loop
        self._early = early
        self._heard = heard
        self._pid_namespace = pid_namespace()
        self.slots = [Slot(index, segment) for index, segment in enumerate(segments)]
        self.active: list[Slot] = []

    def hinted(self, hints: bytes) -> list[Slot]:
        """The slots to look at when the client bell rings: each byte names a slot, and a byte that is no slot's number
        means all slots."""
        if set(hints) <= set(range(layout.CLIENT_SLOTS)):
            return [self.slots[index] for index in set(hints)]
        return self.slots

    def look(self, slots: list[Slot]) -> Iterator[News]:
        """Look at these slots, and yield the news. Active slots are looked at once per tick, because a ring may be lost
        and a claim may end; sometimes all slots are, for new clients whose ring was lost."""
        for slot in tuple(slots):
            yield from self._look(slot)

    def commands(self) -> Iterator[News]:
        """The commands of known clients that were not handled yet."""
        for slot in tuple(self.active):
            if values := slot.new("command"):
                yield slot, "command", values

    def lives_ended(self, ready: dict[int, int]) -> Iterator[News]:
        """Drop each client whose lifeline reports its death, even while the kernel still frees its memory, and even if
        a process that it forked still holds the claim."""
        for slot in tuple(self.active):
            if slot.life and slot.life.died(ready):
                yield from self._leave(slot)

    def _watch(self, slot: Slot) -> None:
        """Watch the client's process. If neither its pid nor its futex can be watched, only its claim shows whether it
        is alive, once per tick."""
        # In a container the client's pid means nothing here, or another process.
        known = self._pid_namespace and slot.pid_namespace == self._pid_namespace
        try:
            slot.life = Lifeline(slot.pid if known else 0)
        except (OSError, OverflowError):
            return  # the pid is wrong, or the process has gone already
        self._loop.watch(slot.life.fd, READ)
        self._early.watch(slot.life, slot.segment)

    def _look(self, slot: Slot) -> Iterator[News]:
        if not claim.held(self._claims_fd, slot.index):
            yield from self._leave(slot)
            return
        session = slot.greet()
        if session != slot.session:
            yield from self._leave(slot)
            if not session or session == slot.ended:
                return
            # A program that restarts after a crash must not be heard before that crash is.
            for other in tuple(self.active):
                if not claim.held(self._claims_fd, other.index) or (other.life and other.life.dead()):
                    yield from self._leave(other)
            slot.join(session)
            self.active.append(slot)
            self._watch(slot)
        elif not session:
            return  # a claim alone is no client yet, whatever else the slot contains
        for record in self._heard:
            if values := slot.new(record) if record in ONCE else slot.latest(record):
                yield slot, record, values

    def _leave(self, slot: Slot) -> Iterator[News]:
        if slot.session:
            self.active.remove(slot)
            if slot.life:
                self._loop.forget(slot.life.fd)
                slot.life.close()
                slot.life = None
            yield slot, OVER, (slot.parted(),)
            slot.ended, slot.session = slot.session, 0
