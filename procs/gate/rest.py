"""Rest: decides which ticks the gate can skip while the velocity does not change. It also sets the word `busy`, so that
other processes can rest while nothing can move."""

from __future__ import annotations

from failstop.procs.context import Context
from failstop.procs.loop import NEVER, Loop, Timer

PERIODS_AT_REST = 2
"""The number of periods between two ticks while the gate rests."""


class Rest:
    """Plans the gate's ticks, and the beats between the ticks."""

    def __init__(self, context: Context, loop: Loop, tick: Timer, period_ns: int) -> None:
        self._loop, self._tick, self._period_ns = loop, tick, period_ns
        self._ticked_ns = 0
        """The time when the last tick was due."""
        self._beat = loop.timer()
        self._word, self._bell = context.own.word("busy"), context.bell("supervisor_bell")
        self._word.set(0)

    def beats_alone(self, ready: dict[int, int], now_ns: int) -> bool:
        """Return True if only a beat is due and nothing else has happened, so the remainder of the turn can be
        skipped."""
        return self._beat.pop(now_ns) and not ready and now_ns < self._loop.due_ns()

    def ticked(self, now_ns: int) -> None:
        """Record that a tick begins. Missed ticks are not made up for."""
        self._ticked_ns = max(self._tick.ns, now_ns - self._period_ns // 2)

    def plan_tick(self, now_ns: int, *, busy: bool, rests: bool) -> None:
        """Plan the next tick. Call this at the end of each turn. The next tick comes one period after the last one, or
        two periods if the gate is late or `rests` is True. `rests`: True if one tick in two periods is enough. `busy`:
        True if something could move, or if a client is present."""
        if busy != bool(self._word.get()):
            self._word.set(busy)
            self._bell.ring()
        waits = rests or now_ns - self._ticked_ns >= self._period_ns
        self._tick.set(self._ticked_ns + self._period_ns * (PERIODS_AT_REST if waits else 1))
        self._beat.set(now_ns + self._period_ns if busy else NEVER)
