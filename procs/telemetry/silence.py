"""Silence: when the board last sent something, and how long it may pause before it counts as silent. Pure.

This works for boards that send reports without being asked. If a board sends only answers, the supervisor judges its
silence by the unanswered pings (supervisor/proof.py).
"""

from __future__ import annotations

from failstop.board.interface import HEARD_BATTERY, HEARD_IMU, HEARD_OBEYED, HEARD_WHEELS, UNKNOWN_EVERY_NS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection

    from failstop.board.interface import Board

REGULAR = frozenset((HEARD_IMU, HEARD_BATTERY, HEARD_WHEELS, HEARD_OBEYED))
"""The kinds of reports that come regularly. A key or a gamepad sends reports only when somebody touches it."""
LEAST_PAUSE_NS = 700_000_000
"""The shortest pause that can count as silence, in ns. A stalled adapter and a restart of the board, which take up to
about 0.3 s each, don't count."""
DESCRIBED_PAUSES = 4
"""If the board's description gives the longest pause of a healthy board, a pause this many times as long is silence."""
SEEN_FOR_NS = 1_000_000_000
SEEN_PAUSES = 20
"""If the board's description gives no pause, at least this many pauses are measured, for at least SEEN_FOR_NS. Until
the first measurement has ended, a board whose wheel reports come at an unknown rate counts as silent after
DESCRIBED_PAUSES times UNKNOWN_EVERY_NS. Until then, a board that does not report its wheels never counts as silent."""
MEAN_PAUSES, LONGEST_PAUSES = 12, 2
"""After the board's usual pauses were measured, a pause counts as silence if it is at least MEAN_PAUSES times as long
as their mean, and at least LONGEST_PAUSES times as long as the longest of them. If the machine is held up, the measured
pauses are too long. So the measurement is repeated, and a later one can shorten the limit, but not lengthen it."""
NOISE_NS = 2_000_000_000
"""How long after the last readable report unreadable bytes still count as a sign of life, in ns. So a few garbled
reports in a row are no silence."""


class Silence:
    """Keeps when the board at one port last sent something, and how long the board may pause. Times are CLOCK_MONOTONIC
    in ns."""

    def __init__(self, board: Board, patience_ns: int = 0) -> None:
        """`patience_ns`: how long the board may pause, as an earlier telemetry process has measured it; 0 if not
        known."""
        self.said_ns = 0
        """The time when the board last sent something, or 0 if it has not. For unreadable bytes, see NOISE_NS."""
        self.patience_ns = patience_ns
        """How long the board may pause. 0 if that is not known, or if the board sends only answers."""
        self._understood_ns = self._regular_ns = 0
        self._asked = bool(board.pings) and board.ping_ns > 0
        every_ns = board.reports.every_ns
        self._known = self._asked or every_ns not in (0, UNKNOWN_EVERY_NS)
        self._longest_ns = self._pauses = self._begun_ns = 0
        if self._known or not patience_ns:
            self.patience_ns = 0 if self._asked or not every_ns else max(LEAST_PAUSE_NS, DESCRIBED_PAUSES * every_ns)

    def heard(self, kinds: Collection[int], came_ns: int) -> None:
        """Record that bytes have come. `kinds`: the kinds of the reports in them. Empty if the bytes were
        unreadable."""
        if kinds:
            self._understood_ns = came_ns
        if not self._understood_ns or came_ns - self._understood_ns >= NOISE_NS:
            return
        self.said_ns = came_ns
        if not self._known and not REGULAR.isdisjoint(kinds):
            self._learn(came_ns)

    def _learn(self, came_ns: int) -> None:
        before_ns, self._regular_ns = self._regular_ns, came_ns
        if not before_ns:
            self._begun_ns = came_ns
            return
        self._longest_ns = max(self._longest_ns, came_ns - before_ns)
        self._pauses += 1
        passed_ns = came_ns - self._begun_ns
        if passed_ns >= SEEN_FOR_NS and self._pauses >= SEEN_PAUSES:
            found_ns = max(LEAST_PAUSE_NS, MEAN_PAUSES * passed_ns // self._pauses, LONGEST_PAUSES * self._longest_ns)
            self.patience_ns = min(self.patience_ns or found_ns, found_ns)
            self._longest_ns = self._pauses = 0
            self._begun_ns = came_ns

    def forget(self) -> None:
        """Forget what has come, and begin the measurement again. Call this if the port is gone, because the next bytes
        may be from a different device. `patience_ns` stays."""
        self.said_ns = self._understood_ns = self._regular_ns = 0
        self._longest_ns = self._pauses = 0
