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
    from typing import Protocol

    from failstop.procs.loop import Loop
    from failstop.shm.latest import LatestReader
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
        self._command = segment.latest_reader("command")
        self._request = segment.latest_reader("request")
        self._sensed = segment.latest_reader("sensed")
        self._interlocks = segment.latest_reader("interlocks")
        self._attended = segment.latest_reader("attended")
        self._said = segment.latest_reader("said")
        self._arm_goal = segment.latest_reader("arm_goal")
        self._arm_path = segment.latest_reader("arm_path")
        self._command_seq = seen(self._command)
        self._request_seq = seen(self._request)
        self._arm_goal_seq = seen(self._arm_goal)
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
        if entry is None:
            return 0
        try:
            session, self.pid, self.pid_namespace, name = records.HELLO.unpack(entry[2])
        except ValueError:
            return 0
        # Bounded here: the state with all names in it must fit its record, whatever clients call themselves.
        self.name = records.cut(records.printable(name), NAME_BYTES).decode()
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
            self._command_seq = self._request_seq = self._arm_goal_seq = 0
        self.session = self._session_seen = session

    def new_command(self) -> Command | None:
        """The command, when it is new, whole and of this session."""
        entry = self._command.read()
        if entry is None or entry[0] == self._command_seq:
            return None
        self._command_seq, t_ns, payload = entry
        try:
            session, vx, vy, wz, manual, source = records.COMMAND.unpack(payload)
        except ValueError:
            return None
        if session != self.session:
            return None
        return Command(session, self.who(), t_ns, (vx, vy, wz), manual=manual, source=source)

    def new_arm_goal(self) -> tuple[int, int, dict[int, float]] | None:
        """The arm's goal (when, mode, value by servo), when it is new, whole and of this session."""
        entry = self._arm_goal.read()
        if entry is None or entry[0] == self._arm_goal_seq:
            return None
        self._arm_goal_seq, t_ns, payload = entry
        try:
            session, mode, values = records.ARM_GOAL.unpack(payload)
        except ValueError:
            return None
        return (t_ns, mode, values) if session == self.session else None

    def arm_path(self) -> tuple[float, list[int], records.Rows] | None:
        """The trajectory that lies in the slot (share, servos, rows), when it is whole and of this session."""
        entry = self._arm_path.read()
        try:
            session, share, servos, rows = records.ARM_PATH.unpack(entry[2] if entry else b"")
        except ValueError:
            return None
        return (share, servos, rows) if session == self.session else None

    def sensed_ns(self) -> int:
        """When this session said last that the obstacle sensor delivered; 0: never."""
        return self._held(self._sensed)[0]

    def interlocks(self) -> tuple[int, list[str]]:
        """Which conditions this session says hold, and when it said so last; 0: never."""
        return self._held(self._interlocks)

    def attended(self) -> tuple[int, str] | None:
        """When the operator that this session speaks for was there last, 0: is there no more; who it is. None: it
        speaks for none."""
        entry = self._attended.read()
        if entry is None:
            return None
        t_ns, names = self._held(self._attended)
        return (t_ns, records.cut(records.printable(names[0]), NAME_BYTES).decode()) if names else None

    def _held(self, reader: LatestReader) -> tuple[int, list[str]]:
        entry = reader.read()
        if entry is None:
            return 0, []
        try:
            session, names = records.HELD.unpack(entry[2])
        except ValueError:
            return 0, []
        return (entry[1], names) if session == self.session else (0, [])

    def said(self) -> tuple[int, str, str] | None:
        """What this session said last, for people: when, what it sees, what is wrong; None: nothing yet."""
        entry = self._said.read()
        if entry is None:
            return None
        try:
            session, *texts = records.SAID.unpack(entry[2])
        except ValueError:
            return None
        if session != self.session:
            return None
        # Bounded here, as the name is; what cannot be printed would take three bytes for one in the record.
        sees, wrong = (records.cut(records.printable(text), SAID_BYTES).decode() for text in texts)
        return entry[1], sees, wrong

    def new_request(self) -> tuple[int, int, int] | None:
        """The request (number, verb, when it was made), when it is new, whole and of this session."""
        entry = self._request.read()
        if entry is None or entry[0] == self._request_seq:
            return None
        self._request_seq = entry[0]
        try:
            session, number, verb = records.REQUEST.unpack(entry[2])
        except ValueError:
            return None
        return (number, verb, entry[1]) if session == self.session else None


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
            self._listener.client_request(slot, *request, now_ns)
        if command := slot.new_command():
            self._listener.client_command(command, now_ns)

    def _leave(self, slot: Slot, now_ns: int) -> None:
        if slot.session:
            self.active.remove(slot)
            self._stop_watching(slot)
            slot.parted = slot.goodbye()
            self._listener.client_gone(slot, now_ns)
            slot.ended, slot.session = slot.session, 0
