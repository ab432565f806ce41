"""Restarts: how telemetry reacts if the board has restarted. restart.py detects the restarts."""

from __future__ import annotations

from collections.abc import Callable

from failstop.board import interface
from failstop.policy import causes, kinematics
from failstop.policy.causes import Cause
from failstop.procs.context import Context
from failstop.procs.telemetry.restart import RestartWatch


class Restarts:
    """Counts the board's restarts, so that the port owner sends the board its settings again. Stops the robot if the
    board restarts while motion is enabled, because the next motion frame would move the wheels again."""

    def __init__(
        self, context: Context, enabled: Callable[[], bool], note: Callable[..., None], stop: Callable[[Cause], None]
    ) -> None:
        """`enabled`: returns True while motion is enabled. `note`: logs an event. `stop`: makes the port owner stop."""
        board = context.board
        fastest_rps = kinematics.max_wheel_rps(context.settings)
        self._watch = RestartWatch(board.silent_ns, fastest_rps * board.reports.position_per_turn)
        self._regular = interface.HEARD_IMU if board.observed_by == interface.BY_IMU else interface.HEARD_WHEELS
        self._enabled, self._note, self._stop = enabled, note, stop
        self._word = context.own.word("restarts")
        self._told_word = context.segment("port_owner").word("told_ns")
        self._bell = context.bell("port_owner_bell")
        self.forget = self._watch.forget

    def heard(self, kinds: list[int], now_ns: int) -> None:
        """Look for signs of a restart in the kinds of all samples that were just read."""
        reports = kinds.count(self._regular)
        self._act(self._watch.heard(reports, len(kinds) - reports, now_ns))

    def counted(self, positions: tuple[float, ...], t_ns: int) -> None:
        """Look for a sign of a restart in a report of the board's counters."""
        self._act(self._watch.counted(positions, t_ns))

    def obeyed(self, *, zeros: bool) -> None:
        """Look for a sign of a restart in a report of the command that the board obeys."""
        self._act(self._watch.obeyed(zeros=zeros, told_ns=self._told_word.get()))

    def started(self, said: interface.Value, _t_ns: int) -> None:
        """Handle a text that the board prints only when it starts."""
        self._act(self._watch.started(said[0]))

    def _act(self, sign: str) -> None:
        if not sign:
            return
        cause = causes.RESTARTED(sign)
        self._word.set(self._word.get() + 1)
        self._note("restarted", str(cause), {"sign": sign})
        if self._enabled():
            self._stop(cause)
        self._bell.ring()
