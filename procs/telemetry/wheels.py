"""Wheels: what is known of them now, from the board's reports or else from the IMU. Pure.

This is the one fact that every screen shows: they turn, they are still, or nobody knows. The board's own reports count
first, because an IMU only feels that the robot moves, or is being moved.
"""

from __future__ import annotations

from math import nan

from failstop.messages.records import MOST_WHEELS, WHEELS_BY, WHEELS_DO
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import WheelReports

UNKNOWN_WHEELS, ARE_STILL, THEY_TURN = range(len(WHEELS_DO))
SEEN_BY_NOTHING, SEEN_BY_IMU, SEEN_BY_REPORTS = range(len(WHEELS_BY))
NOT_REPORTED = (nan,) * MOST_WHEELS
LEAST_COUNTS = 2.5
"""Less than this is the to and fro of an encoder at rest."""


class Measured:
    """Speeds and turns of the wheels by wire id, as the board reports them."""

    def __init__(self, reports: WheelReports) -> None:
        self._reports = reports
        self.t_ns = 0
        """When the newest report came; 0: never."""
        self.speeds_rps: tuple[float, ...] = ()
        """Turns a second; empty: not known."""
        self.turns: tuple[float, ...] = ()
        """Since the first report; empty: not reported."""
        self._positions: tuple[float, ...] = ()

    def take(self, speeds: Sequence[float], positions: tuple[float, ...], t_ns: int) -> None:
        """Take a report of the board, in its own units."""
        told = self._reports
        elapsed_ns, self.t_ns = t_ns - self.t_ns, t_ns
        if positions and told.position_per_turn:
            moved = self._moved(positions)
            self.turns = tuple(map(sum, zip(self.turns, moved, strict=True))) if moved and self.turns else moved
            if not told.speed_per_rps and elapsed_ns > 0:
                self.speeds_rps = tuple(turns * 1e9 / elapsed_ns for turns in moved)
        if speeds and told.speed_per_rps:
            self.speeds_rps = tuple(speed / told.speed_per_rps for speed in speeds)

    def _moved(self, positions: tuple[float, ...]) -> tuple[float, ...]:
        """Turns since the report before; zeros for the first."""
        told, before = self._reports, self._positions
        self._positions = positions
        if len(before) != len(positions):
            return (0.0,) * len(positions)
        steps = [now - then for now, then in zip(positions, before, strict=True)]
        if told.wraps:
            steps = [(step + told.wraps / 2) % told.wraps - told.wraps / 2 for step in steps]
        return tuple(step / told.position_per_turn for step in steps)


class Way:
    """How far the wheels have gone since they were last at rest, where the board reports positions. A count that
    changes to and fro on the edge of an encoder is no way."""

    def __init__(self, reports: WheelReports) -> None:
        self._counts = 0.0 if reports.speed_per_rps else reports.position_per_turn
        self._from: tuple[float, ...] = ()

    def went(self, turns: tuple[float, ...], *, rest: bool) -> bool:
        """`turns`: of each wheel; `rest`: they are at rest now. True also where nothing is known of positions."""
        if not self._counts:
            return True
        if rest or len(self._from) != len(turns):
            self._from = turns
        steps = [abs(now - then) * self._counts for now, then in zip(turns, self._from, strict=True)]
        return max(steps, default=0.0) >= LEAST_COUNTS


class WheelFact:
    """What is known, and since when. `follow` once for each reading and each news of the gate."""

    def __init__(self, after_ns: int) -> None:
        """`after_ns`: how long wheels may turn on after they were told zero."""
        self._after_ns = after_ns
        self.does = UNKNOWN_WHEELS
        self.by = SEEN_BY_NOTHING
        self.since_ns = 0
        """When they began to do so, as far as is known."""
        self.read_ns = 0
        """The newest reading; 0: there was none."""
        self.unexpected = False
        """They turn although they were told zero for longer than they may."""

    def follow(
        self, read_back: ReadBack, still: StillJudge, told_zero_ns: int, now_ns: int, *, went: bool = True
    ) -> bool:
        """Judge anew; True when what is known has changed. `told_zero_ns`: since when they are told zero, 0: they are
        told to turn. `went`: they have got further than an encoder that rests on the edge of a count."""
        judge: ReadBack | StillJudge = read_back if read_back.judged_ns else still
        before = (self.does, self.by, self.unexpected)
        self.read_ns = judge.judged_ns
        if not judge.judged_ns:
            self.does, self.by = UNKNOWN_WHEELS, SEEN_BY_NOTHING
        else:
            self.does = ARE_STILL if judge.still_ns else THEY_TURN
            self.by = SEEN_BY_REPORTS if judge is read_back else SEEN_BY_IMU
        late = told_zero_ns > 0 and self.read_ns - max(told_zero_ns, self.since_ns) >= self._after_ns
        # Reports that have ended say nothing of now.
        self.unexpected = self.does == THEY_TURN and late and went and now_ns - self.read_ns < self._after_ns
        if before[:2] != (self.does, self.by):
            self.since_ns = judge.still_ns or judge.judged_ns or now_ns
            self.unexpected = False
        return before != (self.does, self.by, self.unexpected)
