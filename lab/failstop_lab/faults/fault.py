"""A row of the fault table, and the words its columns are made of."""

from __future__ import annotations

import dataclasses
from typing import Any

from failstop.policy.causes import Cause
from failstop_lab.boards.traits import Traits

BY_RESET = "reset, then enable"
BY_ENABLE = "enable"
BY_ITSELF = "by itself"
BY_NEW_RUN = "a new start by systemd, then enable"

KILL = "kill"
HANG = "hang"
CONTINUE = "continue"
SPIN = "spin"
CRASH = "crash"
"""Injections into a process: SIGKILL, SIGSTOP, SIGCONT, an endless loop put into its code, SIGSEGV."""

PROCESS_DIES = "a process dies"
PROCESS_HANGS = "a process hangs"
SEVERAL = "several processes at once"
SERVICE_STOPPED = "the service is stopped"
CLIENT_FAILS = "the client that drives fails"
GUARD_FAILS = "the driver at the guard port fails, or the guard does"
ASKED_TO_STOP = "somebody asks for a stop"
SENSOR = "the obstacle sensor or an interlock fails"
USB = "the USB connection drops"
BOARD_FAILS = "the board does not take, hear or obey"
BOARD_SAYS_NOTHING = "the board says nothing any more, and hears"
WHEEL_FAILS = "a wheel does not do what it is told"
MACHINE = "the machine is out of something, or takes it away"
MEMORY = "a client damages shared memory"
TIME = "the machine freezes or sleeps, its clock is stepped"
FAULT_CLASSES = (
    PROCESS_DIES,
    PROCESS_HANGS,
    SEVERAL,
    SERVICE_STOPPED,
    CLIENT_FAILS,
    GUARD_FAILS,
    ASKED_TO_STOP,
    SENSOR,
    USB,
    BOARD_FAILS,
    BOARD_SAYS_NOTHING,
    WHEEL_FAILS,
    MACHINE,
    MEMORY,
    TIME,
)

CLAIMS_OF: dict[str, tuple[str, ...]] = {
    PROCESS_DIES: ("DEATH-1", "MOVE-2", "CAUSE-1"),
    PROCESS_HANGS: ("HANG-1", "MOVE-2", "CAUSE-1"),
    SEVERAL: ("SEVERAL-1", "MOVE-2"),
    SERVICE_STOPPED: ("END-1",),
    CLIENT_FAILS: ("CLIENT-1", "MOVE-2"),
    GUARD_FAILS: ("CLIENT-1", "GUARD-1", "MOVE-2"),
    ASKED_TO_STOP: ("ASK-1", "CAUSE-1"),
    SENSOR: ("SENSOR-1",),
    USB: ("PORT-1",),
    BOARD_FAILS: ("BOARD-1",),
    BOARD_SAYS_NOTHING: ("SILENCE-1",),
    WHEEL_FAILS: ("RUNAWAY-1",),
    MACHINE: ("ASK-2",),
    MEMORY: ("MEMORY-1",),
    TIME: ("TIME-1",),
}
"""The claims (case/claims.py) that the rows of each class carry; the first is the one whose time they bound."""

LATE_MS = 100.0
"""Added to the bar for the limit that a test asserts: machines that tests run on are shared and busy. Whether the bar
itself holds, a campaign says (docs/reference/faults.md)."""
LATE_START_MS = 1000.0
"""In its place where a new program must start first, which takes several times as long on a busy machine: at a load of
16 on two cores up to 0.8 s were seen."""

Step = tuple[str, str]
Wanted = tuple[Any, ...]
"""A row of the causes, and its first arguments, if they matter."""


def fits(cause: Cause | None, wanted: tuple[Wanted, ...]) -> bool:
    """True when this is one of the causes that are wanted."""
    return cause is not None and any(
        cause.kind is kind and cause.arguments[: len(first)] == tuple(first) for kind, *first in wanted
    )


def in_words(wanted: tuple[Wanted, ...]) -> str:
    """The wanted causes in words."""
    return " or ".join(" ".join((kind.name, *map(str, first))) for kind, *first in wanted)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fault:
    """One row; every column is given by its name."""

    name: str
    event: str
    """One of FAULT_CLASSES."""
    cause: str
    """The fault, in words."""
    first: str
    """The process that stops first; "nobody" where nothing is to stop."""
    latched: tuple[Wanted, ...] = ()
    """The cause that stays latched is one of these; empty: nothing does."""
    cleared: str
    """BY_RESET, BY_ENABLE, BY_ITSELF or BY_NEW_RUN."""
    logged: str = ""
    """Words of the service besides those on the latched stop; empty: none."""
    bar_ms: float | None
    """The longest time to the first stop frame, as the p99 of a campaign; None: this must not stop the wheels."""
    injector: str
    """A name in injectors.INJECTORS."""
    steps: tuple[Step, ...] = ()
    """Injections by process, in this order."""
    counted_from: str = "the fault"
    """The moment that times are taken from."""
    aftermath_s: float = 0.15
    """How long the fault lasts, the clients commanding all the while."""
    fences: bool = False
    """It lasts long enough for the supervisor to kill what hangs; else the hung are continued before."""
    at_once: bool = False
    """Its steps are never apart, so that none of these processes can react to the death of another."""
    stop_tool: bool = False
    """Nobody who can write is left: the campaign starts the stop tool, as systemd's ExecStopPost does."""
    link: str = ""
    """The link to the board by `status` meanwhile; empty: not looked at."""
    needs: frozenset[str] = frozenset()
    """A board must have these for it (boards/traits.py)."""
    weight: int = 4
    """How often a campaign draws it, against the others."""

    @property
    def limit_ms(self) -> float | None:
        """A stop later than this fails; None: any stop fails."""
        return None if self.bar_ms is None else self.bar_ms + (LATE_START_MS if self.stop_tool else LATE_MS)

    @property
    def survives(self) -> bool:
        """Whether the service lives on; else systemd, here the campaign, restarts it."""
        return self.cleared != BY_NEW_RUN

    def at(self, traits: Traits) -> Fault:
        """The row as it is for a board: its bar is later by the board's own line and loop."""
        if self.bar_ms is None or not traits.own_ns:
            return self
        return dataclasses.replace(self, bar_ms=self.bar_ms + traits.own_ns / 1e6)

    def struck(self, *actions: str) -> tuple[str, ...]:
        """The processes that one of these things is done to."""
        return tuple(process for action, process in self.steps if action in actions)
