"""Rest: what the gate leaves out while nothing ramps, and what others do while nobody is there for whom anything could
move: they read the word `busy`."""

from __future__ import annotations

from failstop.procs.loop import NEVER

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.context import Context
    from failstop.procs.loop import Loop, Timer

PERIODS_AT_REST = 2
"""From tick to tick, while nothing needs each of them."""


class Rest:
    """The gate's ticks, and its beats between them."""

    def __init__(self, context: Context, loop: Loop, tick: Timer, others: tuple[Timer, ...], period_ns: int) -> None:
        """`others`: the timers that ask for a whole turn too."""
        self._tick, self._others, self._period_ns = tick, others, period_ns
        self._beat = loop.timer()
        self._word, self._bell = context.own.word("busy"), context.bell("supervisor_bell")
        self._word.set(0)

    def beats_alone(self, ready: dict[int, int], now_ns: int) -> bool:
        """True when nothing has happened and nothing is due but a beat."""
        alone = not ready and now_ns < min(timer.ns for timer in (self._tick, *self._others))
        if alone:
            self._beat.set(NEVER)
        return alone

    def ticked(self, now_ns: int, *, rests: bool) -> None:
        """The next one is due after a period or two. One that was missed is left out, not made up for."""
        period_ns = self._period_ns * (PERIODS_AT_REST if rests else 1)
        self._tick.set(max(self._tick.ns + period_ns, now_ns + self._period_ns // 2))

    def follow(self, now_ns: int, *, busy: bool, rests: bool) -> None:
        """At the end of a whole turn. `busy`: somebody is there for whom something could move."""
        if busy != bool(self._word.get()):
            self._word.set(busy)
            self._bell.ring()
        if not rests and self._tick.ns - self._period_ns > now_ns:
            self._tick.set(self._tick.ns - self._period_ns)
        self._beat.set(now_ns + self._period_ns if busy else NEVER)
