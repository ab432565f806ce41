"""Sources: who may command, in which order. Pure.

A source is named in the settings, with a priority and a timeout of its own. The highest whose command is fresh drives.
A higher one takes over at once; a lower one gets the wheels back only after the higher has been silent for its timeout,
and then from zero along the ramp. The gamepad in its drive mode is a source above all, that no setting or client names.

Enabling motion moves nothing: a source that commands a velocity at that moment is held until it has sent zero, or has
been silent for its timeout. So a stick that somebody still holds, or a program that never stopped commanding, does not
drive off by itself, whatever face it comes from.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import records
from failstop.policy.settings import FIRST_SOURCE, PAD_SOURCE

PAD_PRIORITY = 101
JUST_COMMANDED_NS = 5_000_000_000
"""A program that commanded motion within this time before an enable is likely to command it again."""
PAD_SESSION = records.NOBODY
"""Of the pad's commands, which come from telemetry."""


class Command(Data):
    """A velocity command: who gave it, as which source, when (CLOCK_MONOTONIC ns), and what."""

    session: int
    who: str
    t_ns: int
    velocity: tuple[float, float, float]
    manual: bool = False
    source: str = FIRST_SOURCE

    @property
    def moves(self) -> bool:
        """It asks for a velocity other than zero."""
        return any(self.velocity)

    @property
    def by_hand(self) -> bool:
        """A person drives through a program, and ends a command by letting go of a key. The gamepad says where its
        sticks are for as long as it can be heard, so its silence is a loss."""
        return self.manual and self.source != PAD_SOURCE


class Sources:
    """The last command of each source, and which of them drives."""

    def __init__(self, declared: dict[str, tuple[int, int]], pad_timeout_ns: int) -> None:
        """`declared`: name -> (priority, timeout in ns), the highest first."""
        rows = {PAD_SOURCE: (PAD_PRIORITY, pad_timeout_ns), **declared}
        self._rank = {name: priority for name, (priority, _) in rows.items()}
        self._timeout_ns = {name: timeout_ns for name, (_, timeout_ns) in rows.items()}
        self._commands: dict[str, Command] = {}
        self._held: dict[str, str] = {}
        """Who commands as each source that must let go before it counts."""
        self._driver = ""
        self._asked_ns = -1
        self._found: Command | None = None
        """The command that drives, as of `_asked_ns`: in each turn it is asked for many times."""

    def allows(self, command: Command) -> bool:
        """True for a client as a source of the settings, and for the pad as itself."""
        return command.source in self._rank and (command.source == PAD_SOURCE) == (command.session == PAD_SESSION)

    def fresh(self, source: str, now_ns: int) -> Command | None:
        """The source's command while it is not older than its timeout."""
        command = self._commands.get(source)
        return command if command and now_ns - command.t_ns <= self._timeout_ns[source] else None

    def stale_ns(self, command: Command) -> int:
        """The time at which a command stops counting."""
        return command.t_ns + self._timeout_ns[command.source] + 1

    def rival(self, command: Command, now_ns: int) -> Command | None:
        """The command of another publisher of the same source that still counts."""
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
        """Motion is being enabled: whoever commands a velocity by now must let go first. Returns who that is."""
        fresh = {source: command for source in self._rank if (command := self.fresh(source, now_ns))}
        self._held = {source: command.who for source, command in fresh.items() if command.moves}
        self._asked_ns = -1
        return list(self._held.values())

    def held(self, now_ns: int) -> list[str]:
        """The programs that must let go first, and still command."""
        return [who for source, who in self._held.items() if self.fresh(source, now_ns)]

    def holds(self, now_ns: int) -> bool:
        """True while somebody commands who must let go first."""
        return bool(self.held(now_ns))

    def paused(self, now_ns: int) -> list[tuple[str, int]]:
        """The programs whose last command is a motion that counts no more but is recent, each with its age in ns. A
        program that commands more seldom than its timeout is one: it is not held, because each time it has paused."""
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
        """Motion is disabled: nobody drives. Who commands on is remembered for the next enable."""
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

    def take_over(self, now_ns: int) -> tuple[Command | None, bool]:
        """The command that drives from now on, and True when the wheels fall back to a lower source with it."""
        command = self.driving(now_ns)
        before, self._driver = self._driver, command.source if command else self._driver
        fell_back = command is not None and bool(before) and self._rank[self._driver] < self._rank[before]
        return command, fell_back

    def table(self, now_ns: int) -> list[dict[str, str | int]]:
        """Each source with a command that counts or is held, and the last driver if it fell silent while the wheels
        turned; highest first, for people."""
        driving = self.driving(now_ns)
        rows: list[dict[str, str | int]] = []
        for name, rank in self._rank.items():
            if fresh := self.fresh(name, now_ns):
                state = "held" if name in self._held else "drives" if fresh is driving else "waits"
                rows.append({"source": name, "priority": rank, "who": fresh.who, "state": state})
            elif name == self._driver and (last := self._commands.get(name)) and last.moves and not last.by_hand:
                rows.append({"source": name, "priority": rank, "who": last.who, "state": "silent"})
        return rows
