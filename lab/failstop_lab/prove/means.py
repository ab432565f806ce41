"""Means: what a board gives to a stand test, and what can't be proved without it. Pure."""

from __future__ import annotations

import dataclasses

from failstop.board.interface import BY_WHEELS, Board
from failstop.board.kinds import is_described, wire_of
from failstop.board.wire import COAST
from failstop.policy.proofs import ACKNOWLEDGED_BY, SEEN_BY, WATCHDOGS, observer
from failstop_lab.prove.table import FROZEN, PAD_STOP, Path

NEVER_ACTS = "this board has no watchdog of its own, so it keeps its last speed"
NO_PAD = "this board has no gamepad"
NO_REPORTS = (
    "at rest: nothing here reports whether the wheels turn. Watch them, and use the POWER SWITCH if they keep turning"
)
NO_ANSWER = "acknowledged: this board answers no questions, and does not report which command it obeys"
UNCONFIRMED = "speeds: nobody has confirmed board.per_rps by turning a wheel, so speeds are capped (`failstop setup`)"
SAME_SCALE = "speeds: this board's reports depend on board.per_rps too, so they can't show that it is wrong"
UNMEASURED = "speeds: this board does not report how its wheels turn"
FREEZES = "a frozen computer, a pulled cable"


@dataclasses.dataclass(frozen=True)
class Means:
    """The proofs that a board can give beside *written*."""

    acknowledged_by: str
    """As the board's interface has it; empty: nothing acknowledges."""
    observed_by: str
    """Likewise; empty: nothing observes."""
    pad: bool = False
    """It reports a gamepad's buttons."""
    may_be_blind: bool = False
    """It may have no IMU either, where it reports no wheels."""
    watchdog_s: float = 0.0
    """After how long its own watchdog acts; 0: it has none."""
    does: str = ""
    """Its watchdog's act, as wire.py words it."""
    speeds: str = ""
    """Why its speeds are not proved; empty: it reports them in a unit of their own."""

    def lacks(self, path: Path) -> str:
        """Why this board can't have a path; empty: it can."""
        if path.kind == PAD_STOP and not self.pad:
            return NO_PAD
        return NEVER_ACTS if path.kind == FROZEN and not self.watchdog_s else ""

    def fitted(self, path: Path) -> Path:
        """The path with this board's times."""
        return dataclasses.replace(path, reaction_ms=self.watchdog_s * 1000) if path.kind == FROZEN else path

    def lines(self, *, blind: bool = False) -> list[str]:
        """For people: what proves a stop here."""
        heard = ACKNOWLEDGED_BY.get(self.acknowledged_by, "nothing")
        seen = "nobody but you" if blind or not self.observed_by else SEEN_BY[self.observed_by]
        found = [f"a stop is acknowledged by {heard}; wheels at rest are observed by {seen}"]
        if self.watchdog_s:
            found.append(f"without a host for {self.watchdog_s:g} s the board acts by itself: {WATCHDOGS[self.does]}")
        return found

    def unproved(self, *, blind: bool = False) -> list[str]:
        """For people: what can't be proved here, and why."""
        found = [NO_REPORTS] if blind else []
        if not self.acknowledged_by:
            found.append(NO_ANSWER)
        if self.speeds:
            found.append(self.speeds)
        if not self.pad:
            found.append(f"{PAD_STOP}: {NO_PAD}")
        if not self.watchdog_s:
            found.append(f"{FREEZES}: {NEVER_ACTS}")
        elif self.does == COAST:
            found.append(
                "a frozen computer on a slope: the board's watchdog only cuts the current, so the wheels may roll on"
            )
        return found


def means_of(kind: str, board: Board, *, imu: bool = True) -> Means:
    """The means of this kind of board. `imu`: whether the robot has an IMU (setting board.imu). Raises OwnBoardError, a
    ValueError."""
    seen = observer(board.observed_by, imu=imu)
    if not is_described(kind):
        return Means(board.acknowledged_by, seen, pad=True, may_be_blind=not imu, speeds=_speeds(board))
    watchdog = wire_of(kind).watchdog
    return Means(
        board.acknowledged_by,
        seen,
        False,
        seen != BY_WHEELS,
        watchdog.acts_ns / 1e9,
        watchdog.does if watchdog.acts_ns else "",
        _speeds(board),
    )


def _speeds(board: Board) -> str:
    if board.reports.own_scale:
        return ""
    if board.scale_assumed:
        return UNCONFIRMED
    return SAME_SCALE if board.reports.every_ns else UNMEASURED
