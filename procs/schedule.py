"""Schedule: the frames that are sent by the clock. Pure.

After a cause, the burst is repeated at times that suit the board, in case it lost the first one. While stopped, a zero
frame goes out at 5 Hz, so that a board that restarts or wakes up soon hears a stop.

Pings check that the board hears, right after each stop and otherwise once per period. The board handles frames in
order, so the answer to a ping that was written after a stop proves that its receiver was in step when the stop had
passed. An answer shows which ping it belongs to, but not which sending of that ping. So the order of pings is random,
and after a loss it soon shows how many were lost (board/handled.py).
"""

from __future__ import annotations

from failstop.procs.loop import NEVER, Timer

REPEAT = 1
REFRESH = 2
ZERO_EVERY_NS = 200_000_000
PING_GAP_NS = 50_000_000
"""Two pings are at least this far apart."""

QUICK = 10
"""How many pings are sent in quick succession after the start. Telemetry, which hears the answers, takes some tenths of
a second to start, and until it has heard one nobody knows whether the board hears."""
AGAIN_AFTER_STOP = 4
"""How many more pings follow the first one after a stop. If answers were lost before the stop, because telemetry died,
the first answer after it may belong to an older ping; a few more pings tell the answers apart."""


class Repeats:
    """When to repeat the last stop. `due`: the timer for the next repeat."""

    def __init__(self, due: Timer, after_ns: tuple[int, ...], now_ns: int, zero_ns: int = ZERO_EVERY_NS) -> None:
        """`after_ns`: how long after a stop each repeat is written; `zero_ns`: how long after a stop the first zero
        comes, or after the last repeat if that is later. Each writer has its own."""
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
        """Write nothing before the next stop, because it would interrupt the motion of this process or of another
        one."""
        self._due.set(NEVER)

    def wait(self, until_ns: int) -> None:
        """Delay repeats: after a stall several are due at once and would garble each other."""
        self._due.wait(until_ns)

    def pop(self, now_ns: int) -> int:
        """What must be written now: REPEAT, REFRESH, or 0 for nothing. Each call removes it from the schedule."""
        if not self._due.pop(now_ns):
            return 0
        if self._bursts:
            self._bursts -= 1
            return REPEAT
        self._due.set(now_ns + ZERO_EVERY_NS)
        return REFRESH


class Pings:
    """When to write pings; `index` is the number of the next one."""

    def __init__(self, count: int, period_ns: int, due: Timer, now_ns: int, quick: int = QUICK) -> None:
        """`count`: how many different pings the board has (0: none, and then nobody may wait for `due`); `quick`: how
        many pings are sent in quick succession at first."""
        self._count = count
        self._period_ns = period_ns
        self._sent_ns = now_ns - PING_GAP_NS
        self._quick = self._quick_first = quick
        self._due = due
        self._due.set(now_ns)
        self._mixed = now_ns | 1
        self._before = -1
        self.index = 0

    def stopped(self, now_ns: int) -> None:
        """A stop was written: send a ping soon to find out whether the board heard it, and then a few more."""
        self._quick = max(self._quick, AGAIN_AFTER_STOP)
        self._due.set(max(now_ns, self._sent_ns + PING_GAP_NS))

    def due(self, now_ns: int) -> bool:
        """True when the ping `index` must be written now."""
        return self._count > 0 and self._due.due(now_ns)

    def sent(self, now_ns: int) -> None:
        """The ping `index` was written; plan the next one."""
        self._sent_ns = now_ns
        self._due.set(now_ns + (PING_GAP_NS if self._quick else self._period_ns))
        self._quick = max(0, self._quick - 1)
        self._before, self.index = self.index, self._drawn()

    def _drawn(self) -> int:
        """A random index, but not the same one three times in a row."""
        mixed = self._mixed  # Marsaglia's xorshift, because `random` would cost memory
        mixed ^= mixed << 13 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 7
        self._mixed = mixed ^ mixed << 17 & 0xFFFFFFFFFFFFFFFF
        index = (self._mixed >> 32) % self._count
        return (index + 1) % self._count if index == self.index == self._before else index

    def opened(self, hears_ns: int) -> None:
        """Another port was opened, and its board hears from `hears_ns` on. It is asked as often as a first one, because
        its answers may count for questions that were lost with the port before."""
        self._quick = self._quick_first
        self.wait(hears_ns)

    def wait(self, until_ns: int) -> None:
        """Put the next ping off until `until_ns`, because nobody would hear an answer before."""
        self._sent_ns = max(self._sent_ns, until_ns - PING_GAP_NS)
        self._due.set(max(self._due.ns, until_ns))

    def failed(self, now_ns: int) -> None:
        """The port accepts no bytes now, so try again after the gap."""
        self._due.set(now_ns + PING_GAP_NS)
