"""Sources: which programs may command, and in which order. Pure.

A source is named in the settings, with its own priority and timeout. The highest source with a fresh command drives. A
higher source takes over at once. A lower one gets the wheels back only after the higher one was silent for its timeout,
and then starts from zero along the ramp. The gamepad in its drive mode is a source above all others, which no setting
or client can name.

Enabling motion moves nothing: a source that commands a velocity at that moment is held until it has sent zero, or was
silent for its timeout. So a stick that is still held, or a program that never stopped commanding, does not drive off by
itself, whichever way motion was enabled.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import records
from failstop.policy.settings import FIRST_SOURCE, PAD_SOURCE

PAD_PRIORITY = 101
JUST_COMMANDED_NS = 5_000_000_000
"""A program that commanded motion within this time before an enable is likely to command it again."""
PAD_SESSION = records.NOBODY
"""The session of the pad's commands, which come from telemetry."""


class Command(Data):
    """A velocity command: its session, its source, its time (CLOCK_MONOTONIC ns) and its velocity."""

    session: int
    who: str
    t_ns: int
    velocity: tuple[float, float, float]
    manual: bool = False
    source: str = FIRST_SOURCE

    @property
    def moves(self) -> bool:
        """True if it asks for a velocity other than zero."""
        return any(self.velocity)

    @property
    def by_hand(self) -> bool:
        """True if a person drives through a program and ends a command by letting go of a key. The gamepad reports its
        sticks for as long as it is in range, so its silence is a loss."""
        return self.manual and self.source != PAD_SOURCE


class Sources:
    """The last command of each source, and which source drives."""

    def __init__(self, declared: dict[str, tuple[int, int]], pad_timeout_ns: int) -> None:
        """`declared`: name -> (priority, timeout in ns), the highest first."""
        rows = {PAD_SOURCE: (PAD_PRIORITY, pad_timeout_ns), **declared}
        self._rank = {name: priority for name, (priority, _) in rows.items()}
        self._timeout_ns = {name: timeout_ns for name, (_, timeout_ns) in rows.items()}
        self._commands: dict[str, Command] = {}
        self._held: dict[str, str] = {}
        """For each source that is held, the name of its program."""
        self._driver = ""
        self._asked_ns = -1
        self._found: Command | None = None
        """The command that drove at `_asked_ns`. It is kept because each turn asks for it many times."""

    def allows(self, command: Command) -> bool:
        """True if a client commands as a source of the settings, or the gamepad as its own source."""
        return command.source in self._rank and (command.source == PAD_SOURCE) == (command.session == PAD_SESSION)

    def fresh(self, source: str, now_ns: int) -> Command | None:
        """The source's command, if it is not older than its timeout."""
        command = self._commands.get(source)
        return command if command and now_ns - command.t_ns <= self._timeout_ns[source] else None

    def stale_ns(self, command: Command) -> int:
        """When this command becomes too old."""
        return command.t_ns + self._timeout_ns[command.source] + 1

    def rival(self, command: Command, now_ns: int) -> Command | None:
        """Another program's command for the same source, if it still counts."""
        last = self.fresh(command.source, now_ns)
        return last if last and last.session != command.session else None

    def put(self, command: Command, now_ns: int) -> None:
        """Keep a source's new command; a time stamp from the future counts as now."""
        command.t_ns = min(command.t_ns, now_ns)
        if command.source in self._held:
            before = self._commands.get(command.source)
            if not command.moves or before is None or command.t_ns >= self.stale_ns(before):
                del self._held[command.source]
        self._commands[command.source] = command
        self._asked_ns = -1

    def hold(self, now_ns: int) -> list[str]:
        """Hold each source that commands a velocity while motion is being enabled: its commands count again after a
        zero or a pause. Returns the names of the programs."""
        fresh = {source: command for source in self._rank if (command := self.fresh(source, now_ns))}
        self._held = {source: command.who for source, command in fresh.items() if command.moves}
        self._asked_ns = -1
        return list(self._held.values())

    def held(self, now_ns: int) -> list[str]:
        """The programs that are held and still send commands."""
        return [who for source, who in self._held.items() if self.fresh(source, now_ns)]

    def holds(self, now_ns: int) -> bool:
        """True while a program that is held still sends commands."""
        return bool(self.held(now_ns))

    def paused(self, now_ns: int) -> list[tuple[str, int]]:
        """The programs whose last command was motion, a short time ago, but no longer counts, each with the age of that
        command in ns. Some of them command less often than their timeout; they are not held, because they pause each
        time."""
        last = ((command, now_ns - command.t_ns) for command in self._commands.values() if not command.by_hand)
        return [
            (command.who, age_ns)
            for command, age_ns in last
            if command.moves and age_ns <= JUST_COMMANDED_NS and not self.fresh(command.source, now_ns)
        ]

    def drop(self, session: int) -> None:
        """Forget every command of a session."""
        self._commands = {source: kept for source, kept in self._commands.items() if kept.session != session}
        self._asked_ns = -1

    def clear(self) -> None:
        """Motion was disabled, so no source drives. The sources' commands are kept, so that the next enable can hold
        those that go on commanding."""
        self._held.clear()
        self._driver = ""
        self._asked_ns = -1

    def driving(self, now_ns: int) -> Command | None:
        """The command of the highest source that is fresh and not held."""
        if now_ns != self._asked_ns:
            self._asked_ns = now_ns
            free = (self.fresh(source, now_ns) for source in self._rank if source not in self._held)
            self._found = next(filter(None, free), None)
        return self._found

    def last_driver(self) -> Command | None:
        """The last command of the source that drove last, however old it is."""
        return self._commands.get(self._driver)

    def choose_driver(self, now_ns: int) -> tuple[Command | None, bool]:
        """The command that drives from now on, and True if the wheels fall back from a higher source to this lower
        one."""
        command = self.driving(now_ns)
        before, self._driver = self._driver, command.source if command else self._driver
        fell_back = command is not None and bool(before) and self._rank[self._driver] < self._rank[before]
        return command, fell_back

    def table(self, now_ns: int) -> list[dict[str, str | int]]:
        """A row for each source with a command that counts or is held, and for the last driver if it fell silent while
        the wheels turned; the highest source first, for people."""
        driving = self.driving(now_ns)
        rows: list[dict[str, str | int]] = []
        for name, rank in self._rank.items():
            if fresh := self.fresh(name, now_ns):
                state = "held" if name in self._held else "drives" if fresh is driving else "waits"
                rows.append({"source": name, "priority": rank, "who": fresh.who, "state": state})
            elif name == self._driver and (last := self._commands.get(name)) and last.moves and not last.by_hand:
                rows.append({"source": name, "priority": rank, "who": last.who, "state": "silent"})
        return rows
