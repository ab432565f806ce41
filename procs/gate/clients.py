"""Clients as the gate sees them: whose slot is claimed, what is new in it, who has gone.

Everything is read with pread and believed only when its CRC, its claim and its session agree. A client's name and pid
are what it says of itself, for people to read; nothing depends on their truth.
"""

from __future__ import annotations

from failstop.procs.gate.sources import Command
from failstop.procs.loop import READ
from failstop.shm import claim, layout, records
from failstop.shm.lifeline import Lifeline, pid_namespace

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, Protocol

    from failstop.procs.loop import Loop
    from failstop.shm.cell import Entry, LatestReader
    from failstop.shm.lifeline import EarlyNews
    from failstop.shm.segment import Segment

    class Listener(Protocol):
        """Who acts on what clients do."""

        def client_command(self, command: Command, now_ns: int) -> None: ...

        def client_holds(self, slot: Slot, now_ns: int) -> None: ...

        def client_request(self, slot: Slot, number: int, verb: int, asked_ns: int, now_ns: int) -> None: ...

        def client_gone(self, slot: Slot, now_ns: int) -> None: ...


NAME_BYTES = 64
SAID_BYTES = 190


def seen(reader: LatestReader) -> int:
    """What a restarted gate finds already there is not new: its predecessor may have acted on it."""
    entry = reader.read()
    return entry[0] if entry else 0


class Inbox:
    """One record of a slot."""

    __slots__ = ("_read", "_seq", "_unpack")

    def __init__(self, segment: Segment, name: str, unpack: Callable[[bytes], tuple[Any, ...]]) -> None:
        self._read = segment.latest_reader(name).read
        self._unpack = unpack
        self._seq = 0

    def begin(self, *, after: bool) -> None:
        """What comes from now on is new, and `after`: what is there is not."""
        entry = self._read() if after else None
        self._seq = entry[0] if entry else 0

    def of(self, session: int) -> tuple[Any, ...] | None:
        """When it was written and its values, when it is whole and of this session."""
        entry = self._read()
        return self._believed(entry, session) if entry else None

    def new(self, session: int) -> tuple[Any, ...] | None:
        """The same, once."""
        entry = self._read()
        if entry is None or entry[0] == self._seq:
            return None
        self._seq = entry[0]
        return self._believed(entry, session)

    def _believed(self, entry: Entry, session: int) -> tuple[Any, ...] | None:
        try:
            writer, *values = self._unpack(entry[2])
        except ValueError:
            return None
        return (entry[1], *values) if writer == session else None


class Slot:
    """One client slot and the session that holds it; session 0: nobody."""

    def __init__(self, index: int, segment: Segment) -> None:
        self.index = index
        self.segment = segment
        self.pid = 0
        self.pid_namespace = 0
        self.name = ""
        self.parted = False
        """Who left the slot last said goodbye."""
        self._hello = segment.latest_reader("hello")
        self._greeting: Entry | None = None
        self._greeted = 0
        """The hello that was read last, and whose it is."""
        self._command = Inbox(segment, "command", records.COMMAND.unpack)
        self._request = Inbox(segment, "request", records.REQUEST.unpack)
        self._sensed = Inbox(segment, "sensed", records.HELD.unpack)
        self._interlocks = Inbox(segment, "interlocks", records.HELD.unpack)
        self._attended = Inbox(segment, "attended", records.HELD.unpack)
        self._said = Inbox(segment, "said", records.SAID.unpack)
        self._arm_goal = Inbox(segment, "arm_goal", records.ARM_GOAL.unpack)
        self._speed_limit = Inbox(segment, "speed_limit", records.SPEED_LIMIT.unpack)
        self._arm_path = Inbox(segment, "arm_path", records.ARM_PATH.unpack)
        self._once = (self._command, self._request, self._arm_goal)
        for each in self._once:
            each.begin(after=True)
        self._session_seen = self.greet()
        self.ended = 0
        """The session that held the slot before: what it left there is over."""
        self.life: Lifeline | None = None
        self.session = 0

    def who(self) -> str:
        """The client as people see it."""
        return f"{self.name} (pid {self.pid})"

    def greet(self) -> int:
        """The session that says hello now; 0 when none does."""
        entry = self._hello.read()
        if entry is not self._greeting:
            self._greeting, self._greeted = entry, self._introduced(entry)
        return self._greeted

    def _introduced(self, entry: Entry | None) -> int:
        if entry is None:
            return 0
        try:
            session, self.pid, self.pid_namespace, name = records.HELLO.unpack(entry[2])
        except ValueError:
            return 0
        self.name = _bounded(name, NAME_BYTES)
        return session

    def goodbye(self) -> bool:
        """True when who held the slot has left it in order; False for a death, and for damage."""
        entry = self._hello.read()
        try:
            return entry is not None and records.HELLO.unpack(entry[2])[0] == records.NOBODY
        except ValueError:
            return False

    def join(self, session: int) -> None:
        """A session holds the slot now; a new one counts its records again."""
        if session != self._session_seen:
            for each in self._once:
                each.begin(after=False)
        self.session = self._session_seen = session

    def new_command(self) -> Command | None:
        """The command, when it is new."""
        if found := self._command.new(self.session):
            t_ns, vx, vy, wz, manual, source = found
            return Command(self.session, self.who(), t_ns, (vx, vy, wz), manual=manual, source=source)
        return None

    def new_arm_goal(self) -> tuple[int, int, dict[int, float]] | None:
        """The arm's goal (when, mode, value by servo), when it is new."""
        return self._arm_goal.new(self.session)

    def arm_path(self) -> tuple[float, list[int], records.Rows] | None:
        """The trajectory that lies in the slot (share, servos, rows)."""
        found = self._arm_path.of(self.session)
        return found and found[1:]

    def speed_limit(self) -> int:
        """The speed limit that lies in the slot, percent; 0: none."""
        found = self._speed_limit.of(self.session)
        return found[1] if found else 0

    def sensed_ns(self) -> int:
        """When this session said last that the obstacle sensor delivered; 0: never."""
        found = self._sensed.of(self.session)
        return found[0] if found else 0

    def interlocks(self) -> tuple[int, list[str]]:
        """When this session said last which conditions hold, 0: never; and which."""
        return self._interlocks.of(self.session) or (0, [])

    def attended(self) -> tuple[int, str] | None:
        """When the operator that this session speaks for was there last, 0: is there no more; who it is. None: it
        speaks for none."""
        t_ns, names = self._attended.of(self.session) or (0, [])
        return (t_ns, _bounded(names[0], NAME_BYTES)) if names else None

    def said(self) -> tuple[int, str, str] | None:
        """What this session said last, for people: when, what it sees, what is wrong; None: nothing yet."""
        if found := self._said.of(self.session):
            t_ns, sees, wrong = found
            return t_ns, _bounded(sees, SAID_BYTES), _bounded(wrong, SAID_BYTES)
        return None

    def new_request(self) -> tuple[int, int, int] | None:
        """The request (when it was made, number, verb), when it is new."""
        return self._request.new(self.session)


def _bounded(text: str, room: int) -> str:
    """A client's words for the state and the record `said`, which must hold those of all, whatever they are: what can't
    be printed would take three bytes for one."""
    return records.cut(records.printable(text), room).decode()


class ClientTable:
    """All slots. `active` is the ones that a session holds."""

    def __init__(
        self, segments: list[Segment], claims_fd: int, loop: Loop, early: EarlyNews, listener: Listener
    ) -> None:
        self._claims_fd = claims_fd
        self._loop = loop
        self._early = early
        self._listener = listener
        self._pid_namespace = pid_namespace()
        self.slots = [Slot(index, segment) for index, segment in enumerate(segments)]
        self.active: list[Slot] = []

    def rung(self, hints: bytes, now_ns: int) -> None:
        """The client bell rang: each byte hints at a slot; anything else hints at all of them."""
        if set(hints) <= set(range(layout.CLIENT_SLOTS)):
            for index in set(hints):
                self._look(self.slots[index], now_ns)
        else:
            self.look_at_all(now_ns)

    def look_at_active(self, now_ns: int) -> None:
        """Once a tick: news whose ring was lost, and claims that have ended."""
        for slot in tuple(self.active):
            self._look(slot, now_ns)

    def look_at_all(self, now_ns: int) -> None:
        """Now and then: new clients whose ring was lost."""
        for slot in self.slots:
            self._look(slot, now_ns)

    def lives_ended(self, ready: dict[int, int], now_ns: int) -> None:
        """Whose lifeline has told of its death has gone, even while the kernel takes its memory down, and even if a
        process that it forked still holds the claim."""
        for slot in tuple(self.active):
            if slot.life and slot.life.died(ready):
                self._leave(slot, now_ns)

    def _watch(self, slot: Slot) -> None:
        """Where neither its pid nor its futex can be watched, the claim alone decides, once a tick."""
        # Of a client in a container the number is nobody's here, or somebody else's.
        known = self._pid_namespace and slot.pid_namespace == self._pid_namespace
        try:
            slot.life = Lifeline(slot.pid if known else 0)
        except (OSError, OverflowError):
            return  # a lie, or a process that is gone already
        self._loop.watch(slot.life.fd, READ)
        self._early.watch(slot.life, slot.segment)

    def _stop_watching(self, slot: Slot) -> None:
        if slot.life:
            self._loop.forget(slot.life.fd)
            slot.life.close()
            slot.life = None

    def _look(self, slot: Slot, now_ns: int) -> None:
        if not claim.held(self._claims_fd, slot.index):
            self._leave(slot, now_ns)
            return
        session = slot.greet()
        if session != slot.session:
            self._leave(slot, now_ns)
            if not session or session == slot.ended:
                return
            slot.join(session)
            self.active.append(slot)
            self._watch(slot)
        elif not session:
            return  # a claim alone is nobody yet, whatever else lies in the slot
        self._listener.client_holds(slot, now_ns)
        if request := slot.new_request():
            asked_ns, number, verb = request
            self._listener.client_request(slot, number, verb, asked_ns, now_ns)
        if command := slot.new_command():
            self._listener.client_command(command, now_ns)

    def _leave(self, slot: Slot, now_ns: int) -> None:
        if slot.session:
            self.active.remove(slot)
            self._stop_watching(slot)
            slot.parted = slot.goodbye()
            self._listener.client_gone(slot, now_ns)
            slot.ended, slot.session = slot.session, 0
