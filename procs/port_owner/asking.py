"""Asking: the pings on the wire, each with the time of its writing in shared memory."""

from __future__ import annotations

from time import monotonic_ns

from failstop.messages import layout
from failstop.procs.loop import NEVER, Timer
from failstop.procs.port_owner.schedule import Pings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.context import Context
    from failstop.procs.loop import Loop
    from failstop.procs.port_owner.port_writer import PortWriter


class Asking(Pings):
    """The board's pings, by the clock and after stops."""

    def __init__(self, context: Context, loop: Loop, wire: PortWriter, hears_ns: int) -> None:
        """`hears_ns`: before that nobody would hear one."""
        board, settings = context.board, context.settings
        due = loop.timer() if board.pings else Timer()
        period_ns = min(settings.ns("link.ping_s"), board.ping_ns or NEVER)
        super().__init__(len(board.pings), period_ns, due, hears_ns)
        self._wire, self._pings = wire, board.pings
        self._words = [context.own.word(f"ping_{index}") for index in range(layout.PINGS)]
        self._backlog = 2 * len(board.burst)
        """Bytes under way behind which a ping may queue: it follows a stop at once, to be handled right after it."""

    def follow(self, now_ns: int) -> None:
        """Write the next one, if it is due. The time is that before the write: an answer never seems to come before
        its question."""
        if not self.due(now_ns):
            return
        asked_ns = monotonic_ns()
        if self._wire.free_ns > asked_ns:
            self.wait(self._wire.free_ns)
        elif self._wire.frame(self._pings[self.index], backlog=self._backlog):
            self._words[self.index].set(asked_ns)
            self.sent(asked_ns)
        else:
            self.failed(now_ns)
