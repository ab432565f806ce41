"""Handled: up to which write the board has certainly handled the bytes written to it. Pure.

An answer does not say which question it belongs to, nor an echo which frame. But the board handles frames in the order
in which they were written, and its answers come back in that order too, whatever was lost on the way. So among all the
places where the answers fit the writes, the earliest is never later than the true one. That place is what counts: then
no delay can make an old answer prove a new stop.

After a loss the earliest place lags behind the true one, so a stop may be acknowledged late or not at all. It catches
up soon if the writes follow no regular order (schedule.Pings, Motion.marked).
"""

from __future__ import annotations

from collections import deque

from failstop.board.interface import HEARD_OBEYED, HEARD_PONG, Board

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Value

COMMANDED = 255
"""Used in place of a ping's index: a command was written."""
GIVEN_UP_NS = 10_000_000_000
"""A question that has no answer after this time never gets one. All proofs of a stop depend on this: if a line held
bytes back for longer, there and back together, a late answer could look like an early one."""
COMMANDS_KEPT = 512
ONE_STOP_NS = 20_000_000
"""Stops that several writers write within this time count as one, because all of them answer the same cause."""
MARGIN_NS = 100_000_000
"""By how much a board's own watchdog may act early."""


class Answers:
    """Questions that may still be answered, in the order in which they were asked."""

    def __init__(self) -> None:
        self._open: deque[tuple[int, int]] = deque()

    def asked(self, index: int, asked_ns: int) -> None:
        """The question with this index is about to be written."""
        self._open.append((index, asked_ns))

    def answered(self, indices: Sequence[int], came_ns: int) -> int:
        """When the earliest question was asked to which this can be the answer; 0 if there is none. `indices`: the
        questions that have this answer. All questions before that one are closed, because their answers were lost."""
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
    """Commands that the board may still report as obeyed, for a board without pings.

    An echo of zeros proves a stop only if the echo of motion came before it, because a board with a broken command wire
    reports zero too. The board also reports zero when its own watchdog has acted, so the motion must be younger than
    that.
    """

    def __init__(self, fades_ns: int) -> None:
        """`fades_ns`: how long after the last frame its watchdog sets the command to zero; 0: it has none."""
        self._fades_ns = max(1, fades_ns - MARGIN_NS) if fades_ns else 0
        self._open: deque[tuple[tuple[float, ...], int]] = deque(maxlen=COMMANDS_KEPT)
        self._written: tuple[float, ...] | None = None
        self._obeyed: tuple[float, ...] | None = None
        self._moved_ns = 0
        """When the motion was written that the board last reported as obeyed; 0 if it does not report motion."""
        self.faded_ns = 0
        """When the last motion was written that the board has heard, if its own watchdog has set the command to zero
        since then; else 0."""

    def wrote(self, speeds: Sequence[float], written_ns: int) -> None:
        """A command was written. Of equal commands in a row only the first counts."""
        if (written := tuple(speeds)) != self._written:
            self._written = written
            self._open.append((written, written_ns))

    def obeyed(self, speeds: Sequence[float], came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """When the stop was written that this report proves; 0 if it proves none. `others_ns`: when other processes
        last wrote a stop."""
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
        """The place of the earliest command with these speeds, and when it was written; zeros if there is none."""
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
    """Follows how far the board has handled what was written, by everything that it reports. Call wrote() before each
    write, and heard() for each report."""

    def __init__(self, board: Board, since_ns: int = 0) -> None:
        """`since_ns`: everything that was written until then counts as handled."""
        self._board, self._since_ns = board, since_ns
        self._answers, self._echo = Answers(), Echo(board.fades_ns)
        self._by_echo = board.echo_ns > 0
        self._zeros = False
        self.asked_ns = 0
        """When the newest question that is known to be answered was written."""

    @property
    def faded_ns(self) -> int:
        """When the last motion was written that the board's own watchdog has ended, as in Echo; else 0."""
        return self._echo.faded_ns

    def wrote(self, index: int, speeds: Sequence[float], written_ns: int) -> None:
        """A ping with this index, or (index COMMANDED) a command with these speeds, is about to be written."""
        if written_ns <= self._since_ns:
            return
        if index == COMMANDED:
            self._echo.wrote(speeds, written_ns)
        else:
            self._answers.asked(index, written_ns)

    def heard(self, kind: int, said: Value, came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """Handle a report that came at `came_ns`. Returns the time of a write (ns) up to which the board has now
        handled everything, and obeys a stop that was among it; 0: nothing new is proved. `others_ns`: see Echo."""
        if kind == HEARD_PONG:
            if not (asked_ns := self._answers.answered(said, came_ns)):
                return 0
            self.asked_ns = asked_ns
            return asked_ns if self._zeros or not self._by_echo else 0
        if kind == HEARD_OBEYED and self._by_echo:
            self._zeros = bool(said) and not any(said)
            return 0 if self._board.pings else self._echo.obeyed(said, came_ns, others_ns)
        return 0
