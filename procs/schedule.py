"""Schedule: when to write the frames that are sent at set times: repeats of a stop, zeros, and pings. Pure.

After a stop, the burst is repeated at times that suit the board, in case the board lost the first one. While the robot
is stopped, a zero frame is written every 0.2 s, so that a board soon gets a stop after it has restarted or woken up.

Pings check that the board hears. They are written right after each stop, and otherwise once per period. The board
handles frames in order, so the answer to a ping after a stop proves that the board was receiving when the stop arrived.

A board has a few different pings, and each is sent again and again. An answer shows which ping it answers, but not when
this ping was sent. The order of the pings is random, so that after a loss the answers soon show how many were lost
(board/handled.py).
"""

from __future__ import annotations

from failstop.procs.loop import NEVER, Timer

REPEAT = 1
REFRESH = 2
ZERO_EVERY_NS = 200_000_000
PING_GAP_NS = 50_000_000
"""The shortest time between two pings."""

QUICK = 10
"""How many pings quickly follow the first one after a port was opened. Nobody knows whether the board hears until
telemetry has read an answer, and telemetry takes some tenths of a second to start."""
QUICK_AGAIN = 40
"""How many pings quickly follow the first one after a lost port was opened again. The board may hear only a second
later. Its first answers then count as answers to pings that were lost with the old port, one or two of them with each
answer, and prove nothing about the new port."""
AGAIN_AFTER_STOP = 4
"""How many more pings follow the first ping after a stop. One answer may not be enough. If telemetry has died, answers
to pings from before the stop may be lost, so the first answer after the stop may belong to one of these older pings.
The answers to the further pings show which ping was answered."""


class Repeats:
    """Decides when to repeat the last stop, and when to send the zeros that follow the repeats. `due`: the timer for
    the next frame."""

    def __init__(self, due: Timer, after_ns: tuple[int, ...], now_ns: int, zero_ns: int = ZERO_EVERY_NS) -> None:
        """`after_ns`: how long after a stop each repeat is written. `zero_ns`: how long after a stop the first zero is
        written. If the last repeat comes at this time or later, the first zero is written `zero_ns` after the last
        repeat. Each process that writes stops has its own times."""
        last_ns = max((0, *after_ns))
        self._after_ns = (*after_ns, zero_ns if zero_ns > last_ns else last_ns + zero_ns)
        self._bursts = 0
        self._due = due
        due.set(now_ns)

    def restart(self, now_ns: int) -> None:
        """Begin the repeats of a stop that was written at `now_ns`."""
        self._bursts = len(self._after_ns) - 1
        self._due.set(*(now_ns + after for after in self._after_ns))

    def end(self) -> None:
        """Write nothing until the next stop. Call it when motion has started, because a repeat would interrupt the
        motion."""
        self._due.set(NEVER)

    def wait(self, until_ns: int) -> None:
        """Postpone the next repeat to `until_ns` if it is due earlier. After a stall, several repeats would otherwise
        be due at once and garble each other."""
        self._due.wait(until_ns)

    def pop(self, now_ns: int) -> int:
        """Return what must be written now: REPEAT (the burst), REFRESH (a zero frame), or 0 for nothing. Each is
        returned once."""
        if not self._due.pop(now_ns):
            return 0
        if self._bursts:
            self._bursts -= 1
            return REPEAT
        self._due.set(now_ns + ZERO_EVERY_NS)
        return REFRESH


class Pings:
    """Decides when to write pings. `index` is the number of the ping to write next."""

    def __init__(self, count: int, period_ns: int, due: Timer, now_ns: int, quick: int = QUICK) -> None:
        """`count`: how many different pings the board has. If it is 0, `due` stays due forever, so it must not be a
        timer of a loop, which would never sleep. `period_ns`: the usual time between two pings. `quick`: how many pings
        quickly follow the first one."""
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
        """Plan a ping soon after a stop that was just written, and a few more quickly after it, to find out whether the
        board heard the stop."""
        self._quick = max(self._quick, AGAIN_AFTER_STOP)
        self._due.set(max(now_ns, self._sent_ns + PING_GAP_NS))

    def due(self, now_ns: int) -> bool:
        """Return True if the ping `index` must be written now."""
        return self._count > 0 and self._due.due(now_ns)

    def sent(self, now_ns: int) -> None:
        """Record that the ping `index` was written, and plan the next one."""
        self._sent_ns = now_ns
        self._due.set(now_ns + (PING_GAP_NS if self._quick else self._period_ns))
        self._quick = max(0, self._quick - 1)
        self._before, self.index = self.index, self._drawn()

    def _drawn(self) -> int:
        """Return a random index. With several pings, it is never the same three times in a row."""
        mixed = self._mixed  # Marsaglia's xorshift, because `random` would cost memory
        mixed ^= mixed << 13 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 7
        self._mixed = mixed ^ mixed << 17 & 0xFFFFFFFFFFFFFFFF
        index = (self._mixed >> 32) % self._count
        return (index + 1) % self._count if index == self.index == self._before else index

    def opened(self, hears_ns: int) -> None:
        """Send quick pings, because a lost port was opened again. `hears_ns`: when the board at the new port begins to
        receive bytes."""
        self._quick = max(self._quick, QUICK_AGAIN)
        self.wait(hears_ns)

    def wait(self, until_ns: int) -> None:
        """Postpone the next ping to `until_ns`, because the board could not answer it before."""
        self._sent_ns = max(self._sent_ns, until_ns - PING_GAP_NS)
        self._due.set(max(self._due.ns, until_ns))

    def failed(self, now_ns: int) -> None:
        """Try the ping again after PING_GAP_NS, because the port accepted no bytes."""
        self._due.set(now_ns + PING_GAP_NS)
