"""Schedule: what goes out by the clock. Pure.

After a cause the burst is repeated at the board's times, in case it lost the first. While stopped a zero frame goes
out at 5 Hz, so that a board that restarts or wakes hears a stop soon.

Pings ask the board whether it hears, right after each stop and else with a period. It handles frames in order, so the
answer to a ping that was written after a stop proves that its receiver was in step when the stop had passed it. An
answer says which ping it may belong to, not which time that was asked, so pings follow each other in no regular order:
after a loss it is soon seen how many were lost (board/handled.py).
"""

from __future__ import annotations

from failstop.procs.loop import NEVER, Timer

REPEAT = 1
REFRESH = 2
ZERO_EVERY_NS = 200_000_000
PING_GAP_NS = 50_000_000
"""Two pings are at least this far apart."""

QUICK = 10
"""After the start so many pings follow each other at once: telemetry, which hears the answers, takes some tenths of a
second to start, and until it has heard one nobody knows whether the board does."""


class Repeats:
    """Repeats of the last stop; `due`: when the next one is written."""

    def __init__(self, due: Timer, after_ns: tuple[int, ...], now_ns: int, zero_ns: int = ZERO_EVERY_NS) -> None:
        """`after_ns`: how long after a stop it is written again; `zero_ns`: how long after a stop the first zero comes,
        or after the last repeat if that is later. Each writer has its own."""
        last_ns = max((0, *after_ns))
        self._after_ns = (*after_ns, zero_ns if zero_ns > last_ns else last_ns + zero_ns)
        self._bursts = 0
        self._due = due
        due.set(now_ns)

    def restart(self, now_ns: int) -> None:
        """Begin the repeats of a stop that was just written."""
        self._bursts = len(self._after_ns) - 1
        self._due.set(*(now_ns + after for after in self._after_ns))

    def end(self) -> None:
        """Write nothing before the next stop: it would cut into motion, of this process or of another."""
        self._due.set(NEVER)

    def wait(self, until_ns: int) -> None:
        """Put repeats off until then: those that a held-up process owes would touch each other on the line."""
        self._due.wait(until_ns)

    def take(self, now_ns: int) -> int:
        """REPEAT, REFRESH or 0: what is to be written now. Asking takes it off the schedule."""
        if not self._due.take(now_ns):
            return 0
        if self._bursts:
            self._bursts -= 1
            return REPEAT
        self._due.set(now_ns + ZERO_EVERY_NS)
        return REFRESH


class Pings:
    """When to ask; `index` is that of the next ping."""

    def __init__(self, count: int, period_ns: int, due: Timer, now_ns: int, quick: int = QUICK) -> None:
        """`count` different pings (0: none, and nobody may wait for `due`); `quick`: so many come at once at first."""
        self._count = count
        self._period_ns = period_ns
        self._sent_ns = now_ns - PING_GAP_NS
        self._quick = quick
        self._due = due
        self._due.set(now_ns)
        self._mixed = now_ns | 1
        self._before = -1
        self.index = 0

    def stopped(self, now_ns: int) -> None:
        """A stop was written: ask whether it was heard."""
        self._due.set(max(now_ns, self._sent_ns + PING_GAP_NS))

    def due(self, now_ns: int) -> bool:
        """True when the ping `index` is to be written now."""
        return self._count > 0 and self._due.due(now_ns)

    def sent(self, now_ns: int) -> None:
        """Plan the next ping, since the ping `index` was written."""
        self._sent_ns = now_ns
        self._due.set(now_ns + (PING_GAP_NS if self._quick else self._period_ns))
        self._quick = max(0, self._quick - 1)
        self._before, self.index = self.index, self._drawn()

    def _drawn(self) -> int:
        """Any index, but none for the third time: each question is asked at least as often as the other one."""
        mixed = self._mixed  # Marsaglia's xorshift: `random` would cost memory
        mixed ^= mixed << 13 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 7
        self._mixed = mixed ^ mixed << 17 & 0xFFFFFFFFFFFFFFFF
        index = (self._mixed >> 32) % self._count
        return (index + 1) % self._count if index == self.index == self._before else index

    def wait(self, until_ns: int) -> None:
        """Put the next ping off until then, as nobody would hear one before."""
        self._sent_ns = max(self._sent_ns, until_ns - PING_GAP_NS)
        self._due.set(max(self._due.ns, until_ns))

    def failed(self, now_ns: int) -> None:
        """The port takes nothing now: try again after the gap."""
        self._due.set(now_ns + PING_GAP_NS)
