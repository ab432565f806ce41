"""Handled: up to which write the board has certainly handled what was written to it. Pure.

No answer on these wires says which question it belongs to, and no echo says which frame. But the board handles frames
in the order in which they were written, and whatever was lost on the way, what comes back is in that order too. So of
all places at which the answers fit into what was written, the earliest is never later than the true one. That place is
what counts: a delay can't make an old answer prove a new stop.

After a loss the earliest place lags behind the true one, and a stop may then be acknowledged late or not at all. It
catches up soon where what is written follows no regular order (schedule.Pings, Motion.marked).
"""

from __future__ import annotations

from collections import deque

from failstop.board.interface import HEARD_OBEYED, HEARD_PONG, Board

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Value

COMMANDED = 255
"""In the place of a ping's index: what was written is a command."""
GIVEN_UP_NS = 10_000_000_000
"""A question that was not answered for as long never will be. Every stop proof rests on this: a line that holds bytes
back for longer, there and back together, may make a late answer look like an early one."""
COMMANDS_KEPT = 512
ONE_STOP_NS = 20_000_000
"""Stops of several writers within this time are one stop: each answers the same cause."""
MARGIN_NS = 100_000_000
"""A board's own watchdog may be early by as much."""


class Answers:
    """Questions that may still be answered, in the order in which they were asked."""

    def __init__(self) -> None:
        self._open: deque[tuple[int, int]] = deque()

    def asked(self, index: int, asked_ns: int) -> None:
        """The question of this index is about to be written."""
        self._open.append((index, asked_ns))

    def answered(self, indices: Sequence[int], came_ns: int) -> int:
        """When the earliest question was asked that this can be the answer to; 0: none can. `indices`: those that are
        answered like this. All before it are closed: what was not answered in its turn was lost."""
        while self._open and came_ns - self._open[0][1] > GIVEN_UP_NS:
            self._open.popleft()
        for at, (index, asked_ns) in enumerate(self._open):
            if asked_ns > came_ns:
                break
            if index in indices:
                for _ in range(at + 1):
                    self._open.popleft()
                return asked_ns
        return 0


class Echo:
    """Commands that the board may still say it obeys, for a board that is asked nothing.

    An echo of zeros proves a stop only when the echo of motion came before it: a board whose command wire is broken
    says zero too. It also says so when its own watchdog has acted, so the motion must be younger than that.
    """

    def __init__(self, fades_ns: int) -> None:
        """`fades_ns`: so long after the last frame its watchdog sets the command to zero; 0: it has none."""
        self._fades_ns = max(1, fades_ns - MARGIN_NS) if fades_ns else 0
        self._open: deque[tuple[tuple[float, ...], int]] = deque(maxlen=COMMANDS_KEPT)
        self._written: tuple[float, ...] | None = None
        self._obeyed: tuple[float, ...] | None = None
        self._moved_ns = 0
        """When the motion was written that it said last to obey; 0: it does not say that it moves."""
        self.faded_ns = 0
        """When the motion was written after which it heard nothing more, so that its own watchdog set the command to
        zero; 0: it does not say zero, or for another reason."""

    def wrote(self, speeds: Sequence[float], written_ns: int) -> None:
        """A command was written; of equal ones in a row the first counts."""
        if (written := tuple(speeds)) != self._written:
            self._written = written
            self._open.append((written, written_ns))

    def obeyed(self, speeds: Sequence[float], came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """When the stop was written that this report proves; 0: it proves none. `others_ns`: when other processes have
        written a stop last."""
        if (obeyed := tuple(speeds)) == self._obeyed:
            return 0
        self._obeyed = obeyed
        at, written_ns = self._earliest(obeyed, came_ns)
        if any(obeyed):
            self._moved_ns, self.faded_ns = written_ns, 0
            self._close(at)
            return 0
        moved_ns, self._moved_ns = self._moved_ns, 0
        if not moved_ns:
            return 0
        if self._fades_ns and came_ns - moved_ns >= self._fades_ns:
            self.faded_ns = moved_ns
            return 0
        stops_ns = [other_ns for other_ns in others_ns if moved_ns < other_ns <= came_ns]
        stops_ns += [written_ns] if written_ns else []
        if not stops_ns:
            return 0
        latest_ns = max(each for each in stops_ns if each - min(stops_ns) <= ONE_STOP_NS)
        if written_ns and written_ns <= latest_ns:
            self._close(at)
        return latest_ns

    def _earliest(self, speeds: tuple[float, ...], came_ns: int) -> tuple[int, int]:
        """The place of the earliest such command, and when it was written; zeros: there is none."""
        for at, (written, written_ns) in enumerate(self._open):
            if written_ns > came_ns:
                break
            if written == speeds:
                return at + 1, written_ns
        return 0, 0

    def _close(self, count: int) -> None:
        for _ in range(count):
            self._open.popleft()


class Handled:
    """Follows how much a board has handled, by all that it says: wrote() everything that was written, then heard()."""

    def __init__(self, board: Board, since_ns: int = 0) -> None:
        """`since_ns`: what was written until then is known to be handled."""
        self._board, self._since_ns = board, since_ns
        self._answers, self._echo = Answers(), Echo(board.fades_ns)
        self._by_echo = board.echo_ns > 0
        self._zeros = False
        self.asked_ns = 0
        """When the newest question was written that is known to be answered."""

    @property
    def faded_ns(self) -> int:
        """As in Echo."""
        return self._echo.faded_ns

    def wrote(self, index: int, speeds: Sequence[float], written_ns: int) -> None:
        """The ping of this index is about to be written, or, where the index is COMMANDED, these speeds."""
        if written_ns <= self._since_ns:
            return
        if index == COMMANDED:
            self._echo.wrote(speeds, written_ns)
        else:
            self._answers.asked(index, written_ns)

    def heard(self, kind: int, said: Value, came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """Returns the time of a write (ns): by what the board has said at `came_ns` it has handled everything up to
        there, and obeys a stop among it. 0: nothing new is proved. `others_ns`: as in Echo."""
        if kind == HEARD_PONG:
            if not (asked_ns := self._answers.answered(said, came_ns)):
                return 0
            self.asked_ns = asked_ns
            return asked_ns if self._zeros or not self._by_echo else 0
        if kind == HEARD_OBEYED and self._by_echo:
            self._zeros = bool(said) and not any(said)
            return 0 if self._board.pings else self._echo.obeyed(said, came_ns, others_ns)
        return 0
