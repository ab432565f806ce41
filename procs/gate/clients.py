"""Clients, as the gate sees them: which slots are claimed, what is new in them, and which clients have gone.

The gate reads all slots with pread. It believes a record only if its CRC is right, the slot is claimed and the session
matches. A client chooses the name and pid that it shows. The name is only for people. The gate watches the pid for the
client's death. It also notices when the client's claim ends.
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
"""Something new from a client: (its slot, the name of a record, a tuple of the record's time in ns and its values). If
the client's session has ended: (its slot, OVER, a tuple whose only value is True if the session said goodbye). If the
session shows another name: (its slot, RENAMED, a tuple with what Slot.who() returns)."""
OVER = "gone"
"""Stands in News instead of the name of a record if the client's session has ended."""
RENAMED = "renamed"
ONCE = ("command", "request", "arm_goal", "aux")
"""The records that the gate acts on only once. It reads the other records at every look, even if they have not
changed."""


def newest_number(reader: LatestReader) -> int:
    """Return the number of the newest entry, or 0 if there is none. A new gate ignores entries up to this number,
    because the previous gate may have acted on them."""
    entry = reader.read()
    return entry[0] if entry else 0


class Slot:
    """One client slot, and the session that holds it. Session 0 means that no client holds the slot."""

    def __init__(self, index: int, segment: Segment) -> None:
        self.index = index
        self.segment = segment
        self.pid = 0
        self.pid_namespace = 0
        self.name = ""
        self._hello, self._left = segment.latest_reader("hello"), segment.latest_reader("left")
        self.greeting: Entry | None = None
        """The entry that was last read from `hello`."""
        self._greeted: int | None = None
        """The session in `greeting`, or None if that entry is damaged."""
        self._readers = {name: segment.latest_reader(name) for name in records.OF_SESSION}
        # Requests start at 0, because the gate's own record says which of them were answered (requests.py).
        self._seen = {name: 0 if name == "request" else newest_number(self._readers[name]) for name in ONCE}
        self._session_seen = self.greet()
        self.ended = 0
        """The last session that has left this slot. Records of that session no longer count."""
        self.life: Lifeline | None = None
        self.session = 0

    def who(self) -> str:
        return f"{self.name} (pid {self.pid})"

    def greet(self) -> int | None:
        """Return the session in the slot's hello, or None if there is no hello or it is damaged."""
        entry = self._hello.read()
        if entry is not self.greeting:
            self.greeting, self._greeted = entry, None
            try:
                if entry:
                    self._greeted, self.pid, self.pid_namespace, name = records.HELLO.unpack(entry[2])
                    self.name = bounded(name, records.WHO_BYTES)
            except ValueError:
                return None
        return self._greeted

    def parted(self) -> bool:
        """Return True if the session that holds the slot has said goodbye."""
        entry = self._left.read()
        try:
            return entry is not None and self.session in records.LEFT.unpack(entry[2])
        except ValueError:
            return False

    def join(self, session: int) -> None:
        """Let a session hold the slot. If the session is new, all of its records count as new."""
        if session != self._session_seen:
            self._seen = dict.fromkeys(ONCE, 0)
        self.session = self._session_seen = session

    def latest(self, name: str) -> tuple[Any, ...] | None:
        """Return (time in ns, *values) of the newest record with this name. None if there is none, or if it is damaged
        or from another session."""
        return self._believed(records.OF_SESSION[name], self._readers[name].read())

    def new(self, name: str) -> tuple[Any, ...] | None:
        """Return the newest record, like latest(), but each record only once. None if there is no new record."""
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

    def command(self, t_ns: int, vx: float, vy: float, wz: float, flags: int, source: str) -> Command:
        """Return a command of this session with these values."""
        return Command(self.session, self.who(), t_ns, (vx, vy, wz), source, flags)

    def said(self) -> tuple[int, str, str] | None:
        """Return (time, what the program sees, what is wrong) from the client's last report about itself. The texts are
        for people. None if the session has reported nothing."""
        if found := self.latest("said"):
            t_ns, sees, wrong = found
            return t_ns, bounded(sees, records.SAID_BYTES), bounded(wrong, records.SAID_BYTES)
        return None


def bounded(text: str, room: int) -> str:
    """Return a client's text with unprintable characters replaced, cut to `room` bytes, so that a record has room for
    the texts of all clients."""
    return records.cut(records.printable(text), room).decode()


class ClientTable:
    """Reads all client slots, and finds what is new in them. Act on each item that a method yields before you take the
    next one. `active`: the slots that a session holds."""

    def __init__(
        self, segments: list[Segment], claims_fd: int, loop: Loop, early: EarlyNews, heard: tuple[str, ...]
    ) -> None:
        """`heard`: the names of the records to read, in this order."""
        self._claims_fd = claims_fd
        self._loop = loop
        self._early = early
        self._heard = heard
        self._pid_namespace = pid_namespace()
        self.slots = [Slot(index, segment) for index, segment in enumerate(segments)]
        self.active: list[Slot] = []

    def hinted(self, hints: bytes) -> list[Slot]:
        """Return the slots whose clients have rung the bell. `hints`: the bytes from the bell, each the number of a
        slot. If any byte is not the number of a slot, return all slots."""
        if set(hints) <= set(range(layout.CLIENT_SLOTS)):
            return [self.slots[index] for index in set(hints)]
        return self.slots

    def look(self, slots: list[Slot]) -> Iterator[News]:
        """Yield what is new in these slots, and the end of each session whose claim has ended. Call it once per tick
        for the active slots. Call it now and then for all slots, because the ring of a new client may be lost."""
        for slot in tuple(slots):
            yield from self._look(slot)

    def commands(self) -> Iterator[News]:
        """Yield the new commands of all active clients."""
        for slot in tuple(self.active):
            if values := slot.new("command"):
                yield slot, "command", values

    def lives_ended(self, ready: dict[int, int]) -> Iterator[News]:
        """Drop each client whose lifeline reports its death, and yield the end of its session. Its claim may still be
        held, by a forked child, or because the kernel is still freeing the client's memory."""
        for slot in tuple(self.active):
            if slot.life and slot.life.died(ready):
                yield from self._leave(slot)

    def _watch(self, slot: Slot) -> None:
        """Watch the client's process through its pid and its futex, so that its death is noticed at once. If neither
        works, look() notices that its claim has ended."""
        # If the client runs in a container, its pid means nothing here, or a different process.
        known = self._pid_namespace and slot.pid_namespace == self._pid_namespace
        try:
            slot.life = Lifeline(slot.pid if known else 0)
        except (OSError, OverflowError):
            return  # the pid is wrong, or the process has already ended
        self._loop.watch(slot.life.fd, READ)
        self._early.watch(slot.life, slot.segment)

    def _look(self, slot: Slot) -> Iterator[News]:
        if not claim.held(self._claims_fd, slot.index):
            yield from self._leave(slot)
            return
        before, session = slot.greeting, slot.greet()
        if session != slot.session:
            yield from self._leave(slot)
            if not session or session == slot.ended:
                return
            # If a program restarts after a crash, its crash must be handled before its new session.
            for other in tuple(self.active):
                if not claim.held(self._claims_fd, other.index) or (other.life and other.life.dead()):
                    yield from self._leave(other)
            slot.join(session)
            self.active.append(slot)
            self._watch(slot)
        elif not session:
            return  # the slot is claimed, but without a hello there is no client yet
        elif slot.greeting is not before:
            yield slot, RENAMED, (slot.who(),)
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
