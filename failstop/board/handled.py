"""Handled: finds out which writes the board has certainly handled. Pure.

The same few questions are written again and again, and an answer does not name its write. Neither does an echo, which
is the board's report of its present command. But the board handles frames in the order in which they were written, and
answers in that order too. So failstop matches each answer with the earliest question that it fits. If frames were lost,
this question may be earlier than the one that the board has answered, but it is never later. So an old answer can't
prove a new stop, however late it comes.

A match that is too early may acknowledge a stop late, or not at all. The matches soon become right again, because the
questions and the speeds are written in an irregular order (schedule.Pings, Motion.marked).
"""

from __future__ import annotations

from collections import deque

from failstop.board.interface import HEARD_OBEYED, HEARD_PONG, Board

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Value

COMMANDED = 255
"""The `index` for Handled.wrote() if a command is written instead of a ping."""
GIVEN_UP_NS = 10_000_000_000
"""How long after a question its answer may still come, in ns. All proofs of a stop rely on this limit: if an answer
came even later, failstop could take it for the answer to a newer question."""
COMMANDS_KEPT = 512
ONE_STOP_NS = 20_000_000
"""Stops that several processes write within this time, in ns, count as one stop, because they have the same cause."""
MARGIN_NS = 100_000_000
"""A board's own watchdog may act this much earlier than at its set time, in ns."""


class Answers:
    """Keeps the questions that may still be answered, in the order in which they were asked."""

    def __init__(self) -> None:
        self._open: deque[tuple[int, int]] = deque()

    def asked(self, index: int, asked_ns: int) -> None:
        """Record that the question with this index is about to be written."""
        self._open.append((index, asked_ns))

    def answered(self, indices: Sequence[int], came_ns: int) -> int:
        """Match an answer with the earliest open question that it fits. `indices`: the questions that have this answer.
        Returns the time when the matched question was asked, in ns, or 0 if the answer fits no open question. Closes
        the matched question. Closes all earlier questions too, because their answers were lost."""
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
    """Finds out from the board's reports which stop the board obeys. This is for a board without pings.

    The board's report of the command that it obeys is called an echo. An echo of zeros proves a stop only if an echo of
    motion came before it, because a board whose command wire is broken also reports zeros. A board whose own watchdog
    has acted reports zeros too. So the motion must also have been written so recently that the watchdog can't have
    acted yet.
    """

    def __init__(self, fades_ns: int) -> None:
        """`fades_ns`: if no frame comes for this time, in ns, the board's own watchdog sets the command to zero. 0 if
        the board has no watchdog."""
        self._fades_ns = max(1, fades_ns - MARGIN_NS) if fades_ns else 0
        self._open: deque[tuple[tuple[float, ...], int]] = deque(maxlen=COMMANDS_KEPT)
        self._written: tuple[float, ...] | None = None
        self._obeyed: tuple[float, ...] | None = None
        self._moved_ns = 0
        """If the newest echo is motion, the time when failstop wrote this motion, in ns. Otherwise 0."""
        self.faded_ns = 0
        """The time, in ns, when failstop wrote the last motion, if the board's own watchdog has ended this motion.
        Otherwise 0."""

    def wrote(self, speeds: Sequence[float], written_ns: int) -> None:
        """Record that a command was written. If the same command is written several times in a row, only its first
        write counts."""
        if (written := tuple(speeds)) != self._written:
            self._written = written
            self._open.append((written, written_ns))

    def obeyed(self, speeds: Sequence[float], came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """Handle the board's report that it obeys a command with these speeds. If the report proves a stop, returns the
        time when this stop was written, in ns. Otherwise returns 0. `others_ns`: the times, in ns, when the other
        processes wrote their newest stops."""
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
        """Find the earliest kept command with these speeds. Returns (place, time): its place among the kept commands,
        counted from 1, and when it was written, in ns. Both are 0 if there is none."""
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
    """Tracks which writes the board has handled, as far as the board's reports show it. Call wrote() before each write,
    and heard() for each report."""

    def __init__(self, board: Board, since_ns: int = 0) -> None:
        """Everything that was written until `since_ns`, a time in ns, counts as handled."""
        self._board, self._since_ns = board, since_ns
        self._answers, self._echo = Answers(), Echo(board.fades_ns)
        self._by_echo = board.echo_ns > 0
        self._zeros = False
        self.asked_ns = 0
        """The time when failstop wrote the newest question that has certainly been answered, in ns."""

    @property
    def faded_ns(self) -> int:
        """The time, in ns, when failstop wrote the last motion, if the board's own watchdog has ended this motion.
        Otherwise 0."""
        return self._echo.faded_ns

    def wrote(self, index: int, speeds: Sequence[float], written_ns: int) -> None:
        """Record a write before it is made: the ping with this index, or a command with these speeds if the index is
        COMMANDED."""
        if written_ns <= self._since_ns:
            return
        if index == COMMANDED:
            self._echo.wrote(speeds, written_ns)
        else:
            self._answers.asked(index, written_ns)

    def heard(self, kind: int, said: Value, came_ns: int, others_ns: Sequence[int] = ()) -> int:
        """Handle a report that came at `came_ns`. If the report proves that the board has handled every write up to a
        certain time, returns this time, in ns. If the last command up to this time was a stop, the board has received
        the stop. Returns 0 if the report proves nothing new. `others_ns`: the times, in ns, when the other processes
        wrote their newest stops."""
        if kind == HEARD_PONG:
            if not (asked_ns := self._answers.answered(said, came_ns)):
                return 0
            self.asked_ns = asked_ns
            return asked_ns if self._zeros or not self._by_echo else 0
        if kind == HEARD_OBEYED and self._by_echo:
            self._zeros = bool(said) and not any(said)
            return 0 if self._board.pings else self._echo.obeyed(said, came_ns, others_ns)
        return 0
