"""Proving: publishes which writes the board has handled, and since when the board has reported that it obeys zero
although motion is commanded."""

from __future__ import annotations

from failstop.board.handled import Handled
from failstop.board.interface import HEARD_OBEYED, HEARD_PONG
from failstop.messages import layout, records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.interface import Value
    from failstop.procs.context import Context

FORGOTTEN_NS = 500_000_000
"""A report about the obeyed command says nothing about the present once it is older than this, in ns."""
PAUSE_NS = 100_000_000
"""If the reports about the obeyed command pause for longer than this (in ns) and for longer than two of their periods,
nobody knows what the board obeyed during the pause. The time in which the board obeys zero is then counted only from
the first report after the pause. Even that report may be old, because a stalled adapter delivers reports late."""


class Proving:
    """Publishes three facts: the newest ping that the board has answered (`answered`), the time up to which the board
    has handled every write (`proved`), and since when the board obeys zero although motion is commanded
    (`unheeded_ns`). Everything that was written before the last ping that an earlier telemetry process saw answered
    counts as handled."""

    def __init__(self, context: Context) -> None:
        own = context.own
        self._wrote = context.segment(layout.PORT_OWNER).ring_reader("wrote", from_oldest=True)
        others = (layout.SUPERVISOR, layout.STOPPER)
        self._stopped = [context.segment(name).word("written_ns") for name in others]
        self._bell = context.bell("supervisor_bell")
        self._answered, self._proved = own.latest_writer("answered"), own.latest_writer("proved")
        entry = own.latest_reader("answered").read()
        self._handled = Handled(context.board, records.PROVED.unpack(entry[2])[0] if entry else 0)
        self._unheeded_word = own.word("unheeded_ns")
        self._unheeded_word.set(0)
        self._unheeded_ns = self._obeyed_ns = 0
        self._pause_ns = max(PAUSE_NS, 2 * context.board.reports.every_ns)
        self._told_word = context.segment(layout.PORT_OWNER).word("told_ns")

    @property
    def faded_ns(self) -> int:
        """When the last motion was written, if the board's own watchdog has ended this motion. Otherwise 0."""
        return self._handled.faded_ns

    def answered(self, indices: Value, came_ns: int) -> None:
        """Record an answer of the board. `indices`: the pings that this answer fits; it answers one of them."""
        before_ns = self._handled.asked_ns
        self._record(HEARD_PONG, indices, came_ns)
        if self._handled.asked_ns != before_ns:
            self._answered.write(records.PROVED.pack(self._handled.asked_ns, came_ns), came_ns)
            self._bell.ring()

    def obeyed(self, speeds: Value, came_ns: int, *, moves: bool) -> None:
        """Record a report of the command that the board obeys. `moves`: True if motion is commanded."""
        self._record(HEARD_OBEYED, speeds, came_ns)
        paused, self._obeyed_ns = came_ns - self._obeyed_ns > self._pause_ns, came_ns
        told_ns = self._told_word.get()
        written = max(word.get() for word in self._stopped) < told_ns <= came_ns
        zeros = bool(speeds) and not any(speeds)  # NaN is not zero, and no speeds are no report
        # If the watchdog ended an earlier motion, that says nothing about how the board obeys this motion.
        faded_ns = self.faded_ns if self.faded_ns >= told_ns else 0
        since_ns = faded_ns or (0 if paused else self._unheeded_ns)
        self._publish_unheeded((since_ns or came_ns) if moves and written and zeros else 0)

    def forget(self, now_ns: int) -> None:
        """Clear `unheeded_ns` if the last report of the obeyed command is older than FORGOTTEN_NS. Call this
        regularly."""
        if self._unheeded_ns and now_ns - self._obeyed_ns >= FORGOTTEN_NS:
            self._publish_unheeded(0)

    def _record(self, kind: int, said: Value, came_ns: int) -> None:
        while entry := self._wrote.next():
            self._handled.wrote(*records.WROTE.unpack(entry[2]), entry[1])
        if proved_ns := self._handled.heard(kind, said, came_ns, [word.get() for word in self._stopped]):
            self._proved.write(records.PROVED.pack(proved_ns, came_ns), came_ns)
            self._bell.ring()

    def _publish_unheeded(self, since_ns: int) -> None:
        if since_ns != self._unheeded_ns:
            self._unheeded_ns = since_ns
            self._unheeded_word.set(since_ns)
