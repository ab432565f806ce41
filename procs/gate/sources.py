"""Sources: which programs may command motion, and which of them has priority. Pure.

Each source has a name, a priority and a timeout in the settings. Among the sources that have a fresh command, the one
with the highest priority drives. A source with a higher priority takes over at once. When that source was silent for
its timeout, the lower source gets the wheels back, and the velocity starts from zero along the ramp. The gamepad in its
drive mode has priority over all other sources. No setting and no client can use its name.

Enabling motion moves nothing. A source that commands a velocity at that moment is held: its commands don't count until
it has sent zero or was silent for its timeout. So a stick that is still pushed, or a program that never stopped
commanding, does not make the robot drive off.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import records
from failstop.policy.settings import FIRST_SOURCE, PAD_SOURCE

PAD_PRIORITY = 101
JUST_COMMANDED_NS = 5_000_000_000
"""A program that has commanded motion within this time before an enable is likely to do so again."""
PAD_SESSION = records.NOBODY
"""The session of the gamepad's commands. They come from telemetry, not from a client."""


class Command(Data):
    """A velocity command with its session, the name of its program, its time (CLOCK_MONOTONIC ns), its source and its
    flags (records.COMMAND). The velocity is (vx, vy, wz) in m/s, m/s and rad/s."""

    session: int
    who: str
    t_ns: int
    velocity: tuple[float, float, float]
    source: str = FIRST_SOURCE
    flags: int = 0

    @property
    def manual(self) -> bool:
        """True if a person drives."""
        return bool(self.flags & records.BY_HAND)

    @property
    def moves(self) -> bool:
        """True if the commanded velocity is not zero."""
        return any(self.velocity)

    @property
    def lets_go(self) -> bool:
        """True if the program itself commands zero."""
        return not (self.moves or self.flags & records.STANDS_IN)

    @property
    def by_hand(self) -> bool:
        """True if a person drives through a program. Silence then means that a key was let go. False for the gamepad,
        because its silence means that it was lost."""
        return self.manual and self.source != PAD_SOURCE


class Sources:
    """Keeps the last command of each source, and chooses which source drives."""

    def __init__(self, declared: dict[str, tuple[int, int]], pad_timeout_ns: int, guard_timeout_ns: int) -> None:
        """`declared`: the sources as {name: (priority, timeout in ns)}, the highest priority first.
        `guard_timeout_ns`: how long a motion of a driver at the guard port counts."""
        self._guard_timeout_ns = guard_timeout_ns
        rows = {PAD_SOURCE: (PAD_PRIORITY, pad_timeout_ns), **declared}
        self._rank = {name: priority for name, (priority, _) in rows.items()}
        self._timeout_ns = {name: timeout_ns for name, (_, timeout_ns) in rows.items()}
        self._commands: dict[str, Command] = {}
        self._held: dict[str, str] = {}
        """The sources that are held, each with the name of its program."""
        self._driver = ""
        self._asked_ns = -1
        self._found: Command | None = None
        """The command that drove at `_asked_ns`. It is kept because it is needed many times in each turn."""

    def allows(self, command: Command) -> bool:
        """Return True if the command's sender may use its source. Only the gamepad may use the gamepad's source.
        Clients may use the sources in the settings."""
        return command.source in self._rank and (command.source == PAD_SOURCE) == (command.session == PAD_SESSION)

    def fresh(self, source: str, now_ns: int) -> Command | None:
        """Return the source's last command. None if there is none, or if it is older than the source's timeout."""
        command = self._commands.get(source)
        return command if command and now_ns - command.t_ns <= self._timeout_ns[source] else None

    def stale_ns(self, command: Command) -> int:
        """Return the time when this command will be too old."""
        return command.t_ns + self._timeout_ns[command.source] + 1

    def silent_ns(self, command: Command, now_ns: int) -> int:
        """Return how long ago the program itself commanded this, ns. The time of a driver's command at the guard port
        is that of the guard's last repeat."""
        repeated_ns = self._guard_timeout_ns - self._timeout_ns[command.source]
        return now_ns - command.t_ns + (repeated_ns if command.flags & records.GUARDED else 0)

    def rival(self, command: Command, now_ns: int) -> Command | None:
        """Return a fresh command of another program for the same source, or None."""
        last = self.fresh(command.source, now_ns)
        return last if last and last.session != command.session else None

    def put(self, command: Command, now_ns: int) -> None:
        """Keep a source's new command. A time stamp from the future counts as now. A held source is released by its
        program's own zero, or by its first command after a pause."""
        command.t_ns = min(command.t_ns, now_ns)
        if command.source in self._held:
            before = self._commands.get(command.source)
            if command.lets_go or before is None or command.t_ns >= self.stale_ns(before):
                del self._held[command.source]
        self._commands[command.source] = command
        self._asked_ns = -1

    def hold(self, now_ns: int) -> list[str]:
        """Hold each source whose program wants to move, because motion is being enabled. Returns the names of the held
        programs. A source's commands count again after it has sent zero or paused."""
        fresh = {source: command for source in self._rank if (command := self.fresh(source, now_ns))}
        self._held = {source: command.who for source, command in fresh.items() if not command.lets_go}
        self._asked_ns = -1
        return list(self._held.values())

    def held(self, now_ns: int) -> list[str]:
        """Return the names of the held programs that still send commands."""
        return [who for source, who in self._held.items() if self.fresh(source, now_ns)]

    def holds(self, now_ns: int) -> bool:
        """Return True while a held program still sends commands."""
        return bool(self.held(now_ns))

    def paused(self, now_ns: int) -> list[tuple[str, int]]:
        """Return (name, time since its last command in ns) of each program that commanded motion within the last
        JUST_COMMANDED_NS and has paused since. Programs that a person drives by hand are left out. The returned
        programs are not held, because a held program is released by its first command after a pause."""
        programs = (command for command in self._commands.values() if not command.by_hand)
        last = ((command, self.silent_ns(command, now_ns)) for command in programs)
        return [
            (command.who, age_ns)
            for command, age_ns in last
            if not command.lets_go and age_ns <= JUST_COMMANDED_NS and not self.fresh(command.source, now_ns)
        ]

    def drop(self, session: int) -> None:
        """Forget all commands of a session."""
        self._commands = {source: kept for source, kept in self._commands.items() if kept.session != session}
        self._asked_ns = -1

    def clear(self) -> None:
        """Forget which source drives and which are held, because motion was disabled. The commands are kept, so that
        the next enable can hold the sources that still command motion."""
        self._held.clear()
        self._driver = ""
        self._asked_ns = -1

    def driving(self, now_ns: int) -> Command | None:
        """Return the fresh command of the source with the highest priority that is not held, or None."""
        if now_ns != self._asked_ns:
            self._asked_ns = now_ns
            free = (self.fresh(source, now_ns) for source in self._rank if source not in self._held)
            self._found = next(filter(None, free), None)
        return self._found

    def last_driver(self) -> Command | None:
        """Return the last command of the source that drove last, no matter how old it is."""
        return self._commands.get(self._driver)

    def choose_driver(self, now_ns: int) -> tuple[Command | None, bool]:
        """Choose the command that drives from now on. Returns (command or None, True if it is from a source with a
        lower priority than the source that drove before)."""
        command = self.driving(now_ns)
        before, self._driver = self._driver, command.source if command else self._driver
        fell_back = command is not None and bool(before) and self._rank[self._driver] < self._rank[before]
        return command, fell_back

    def table(self, now_ns: int) -> list[dict[str, str | int]]:
        """Return a table of the sources for people, the highest priority first. It has every source with a fresh
        command, even a held one. If the last driver fell silent while it commanded a velocity, its source is in the
        table too, unless a person drove by hand."""
        driving = self.driving(now_ns)
        rows: list[dict[str, str | int]] = []
        for name, rank in self._rank.items():
            if fresh := self.fresh(name, now_ns):
                state = "held" if name in self._held else "drives" if fresh is driving else "waits"
                rows.append({"source": name, "priority": rank, "who": fresh.who, "state": state})
            elif name == self._driver and (last := self._commands.get(name)) and not (last.lets_go or last.by_hand):
                rows.append({"source": name, "priority": rank, "who": last.who, "state": "silent"})
        return rows
