"""The line to a board: when each byte of timed writes has arrived, with or without a USB adapter between.

An adapter sends what it holds at its next tick, so a gap in one tick is forgotten: two writes become one.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from failstop.board import own
from failstop.board.kinds import is_own
from failstop.board.wire import TimedStop
from failstop_lab.sim.servos import Servos

BAR_NS = 12_000_000
"""From a stop's first write to the command at the wheels, where one or two write it: every board."""
CROWD_BAR_NS = 40_000_000
"""That time where three write it at once, or a frame of motion that was already on its way comes between."""
ADAPTER_BAR_NS = 150_000_000
"""That time behind a USB adapter that forgets gaps, or has stalled and sends several stops at once."""
TimedWrite = tuple[int, bytes]
"""When it is written, in ns, and what."""


class Receiver(Protocol):
    """A board's receiver, under a clock that is handed in."""

    commands: list[tuple[int, tuple[float, ...]]]
    """When which speeds were commanded, in the unit of its motion, by frames alone."""
    said: list[tuple[int, bytes]]
    """When it has said what."""

    @property
    def wheels(self) -> tuple[float, ...]:
        """Speeds that are commanded now; its own watchdog may have set them to zero."""

    def byte(self, at_ns: int, value: int) -> None:
        """Take in one byte whose last bit arrived then."""

    def until(self, at_ns: int) -> None:
        """Let time pass: timeouts, idle lines, reports."""


class Rolling:
    """What the wheels of a receiver do, against what they are told. The faults may be set at any time."""

    if TYPE_CHECKING:

        @property
        def wheels(self) -> tuple[float, ...]:
            """Speeds that are commanded now."""

    faster = 1.0
    """The first wheel turns so many times as fast as it is told, or with a negative number the other way."""
    pushed = 0.0
    """And by so much more, in the unit of the board's motion: somebody pushes it, or it does not obey."""

    lies = 1.0
    """Its reports say that every wheel turns so many times as fast as it does."""
    claims = 0.0
    """And by so much more, in the unit of the board's motion."""

    def answers_until_ns(self) -> int:
        """When its answers have left the line that the host writes on too. 0: there is no such line, or no answer."""
        return 0

    @property
    def rolls(self) -> tuple[float, ...]:
        """Speeds in the unit of its motion."""
        if self.faster == 1.0 and not self.pushed:
            return self.wheels
        first, *others = self.wheels
        return (first * self.faster + self.pushed, *others)

    @property
    def reported(self) -> tuple[float, ...]:
        """Speeds that its reports are made of."""
        if self.lies == 1.0 and not self.claims:
            return self.rolls
        return tuple([speed * self.lies + self.claims for speed in self.rolls])


@dataclass(frozen=True)
class ReceiverModel:
    """Everything that a test needs of one kind's receiver to prove its stop."""

    any_state: Callable[[random.Random], Receiver]
    """A receiver in a state that time and its own reports may have brought it to."""
    live: Callable[[], Receiver]
    """A receiver whose wheels turn as they are told, and whose reports say so."""
    every_state: Callable[[], Iterator[Receiver]]
    """All of these states."""
    before: tuple[bytes, ...]
    """Bytes that may have come before a stop, beside cuts of the board's frames."""
    not_enough: TimedStop
    """A stop that looks enough and is not: the control."""
    fuses: bool
    """Whether pieces of two frames can pass its check as one frame, with any speed, until the next stop."""
    stalls: bool
    """Whether its stop holds behind an adapter that stalls, and then sends everything at once."""
    cut_ns: int = BAR_NS
    """From a stop's first write to the command at the wheels after the worst cut, where one or two write it."""
    pending_ns: int = BAR_NS
    """From a stop's first write to the command at the wheels in the worst of every_state(), where one writes it."""
    boot: bytes = b""
    """Text that it prints when it starts, before its program runs."""
    with_motors: Callable[[int], Receiver] | None = None
    """A live receiver with so many motors. None: all boards of this kind have as many."""
    joints: Callable[[Receiver, int], Servos] | None = None
    """(a live receiver, the moment that its times count from): an arm's servos on the same line. None: there are
    none."""


def model_of(kind: str) -> ReceiverModel:
    """The model of one of the board room's KINDS, or of a folder of the user's own, by its receiver.py. Raises
    ValueError."""
    if is_own(kind):
        own_model: ReceiverModel = own.load(kind, "receiver", "MODEL")
        return own_model
    model: ReceiverModel = __import__(f"failstop_lab.boards.{kind}", fromlist=["MODEL"]).MODEL
    return model


class Tick:
    """A USB adapter's: every `every_ns`, first at `first_ns`. Without one, writes go out at once."""

    def __init__(self, every_ns: int = 1, first_ns: int = 0) -> None:
        self._every_ns = every_ns
        self._first_ns = first_ns

    def after(self, at_ns: int) -> int:
        """The next tick."""
        return at_ns + (self._first_ns - at_ns) % self._every_ns


AT_ONCE = Tick()


def arrivals(writes: Iterable[TimedWrite], byte_ns: int, tick: Tick = AT_ONCE) -> Iterator[tuple[int, int]]:
    """(when, byte) of all bytes. Writes of several writers wait for each other in the kernel, whole ones in order."""
    free_ns = -(10**18)
    for at_ns, data in sorted(writes, key=lambda write: write[0]):
        free_ns = max(free_ns, tick.after(at_ns))
        for value in data:
            free_ns += byte_ns
            yield free_ns, value


def stop_writes(stop: TimedStop, writer: int, begin_ns: int, byte_ns: int) -> Iterator[TimedWrite]:
    """All writes of one writer's stop and its repeats. The writer keeps the gaps between its own writes alone."""
    for repeat_ns in stop.repeats_ns[writer]:
        at_ns = begin_ns + repeat_ns
        for write in stop.writes:
            yield at_ns, write.data
            at_ns += len(write.data) * byte_ns + stop.after_ns + write.idle_ns


def play(receiver: Receiver, bytes_in: Iterable[tuple[int, int]], until_ns: int) -> None:
    """Give a receiver all bytes, and time until then."""
    for at_ns, value in bytes_in:
        receiver.byte(at_ns, value)
    receiver.until(until_ns)
