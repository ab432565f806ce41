"""Pings: when to ask the board whether it hears. Pure.

Frames are handled in order, so an answer to a ping that went out after a stop proves that the board's receiver was in
step when the stop had passed it. A ping goes out right after each stop, and otherwise with a period.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.loop import Timer

GAP_NS = 50_000_000
"""Two pings are at least this far apart, so that one index (of four) is used again only when its answer, which takes a
few milliseconds, is long due."""


class Pings:
    """The schedule; `index` is that of the next ping."""

    __slots__ = ("_count", "_due", "_period_ns", "_sent_ns", "index")

    def __init__(self, count: int, period_ns: int, due: Timer, now_ns: int) -> None:
        """`count` different pings; 0: this board has none, and nobody may wait for `due`, when the next is."""
        self._count = count
        self._period_ns = period_ns
        self._sent_ns = now_ns - GAP_NS
        self._due = due
        self._due.set(now_ns)
        self.index = 0

    def stopped(self, now_ns: int) -> None:
        """A stop was written: ask whether it was heard."""
        self._due.set(max(now_ns, self._sent_ns + GAP_NS))

    def due(self, now_ns: int) -> bool:
        """True when the ping `index` is to be written now."""
        return self._count > 0 and self._due.due(now_ns)

    def sent(self, now_ns: int) -> None:
        """It was written."""
        self._sent_ns = now_ns
        self._due.set(now_ns + self._period_ns)
        self.index = (self.index + 1) % self._count

    def failed(self, now_ns: int) -> None:
        """The port takes nothing now: try again after the gap."""
        self._due.set(now_ns + GAP_NS)
