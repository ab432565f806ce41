"""Restart: detects from the board's bytes that the board has restarted. Pure.

A restarted board has forgotten its speed and its settings, and the next motion frame would move the wheels again. Most
restarts are short: the supply dips, and the board's program starts again at once. There are four signs of a restart:

- The board sends a text that it prints only when it starts.
- Its counters fall to zero, although the wheels can't have turned that far since the last report.
- It reports that it obeys zero, although motion was commanded last and it has already obeyed this motion.
- Its reports pause, and the missing reports do not arrive within KEPT_NS after the pause. An adapter that has only
  stalled delivers them all at once.
"""

from __future__ import annotations

from collections.abc import Sequence

MS = 1_000_000
KEPT_NS = 40 * MS
"""How long after a pause to wait for reports that an adapter may have held back, in ns."""
LEARN_NS = 400 * MS
"""How long it takes to measure how often the board reports."""
MISSING = 0.6
"""A pause in the reports counts as a restart only if at least this share of the reports that were due in the pause
never comes."""
FASTER = 1.5
"""Wheels can't turn a counter faster than this many times the fastest change that was seen before, or than this many
times the highest speed that is allowed."""
FADES = 0.98
"""At each report, the fastest change that was seen is multiplied by this, so that it is forgotten with time."""
LEAST_FALL = 10.0
"""If a counter falls by less than this, in the counter's unit, the robot may just have moved backward. A larger fall
may be a restart of the board."""
CLOSE = 2.0

COUNTERS = "its counters fell to zero"
OBEYS_ZERO = "it obeys zero and was told to drive"


class RestartWatch:
    """Looks for signs of a restart. Each method that gets a report returns the sign that it found as text, or an empty
    text. After a sign, everything is forgotten, so each restart is found only once."""

    def __init__(self, silent_ns: int, fastest: float = 0.0) -> None:
        """`silent_ns`: how long the reports must pause, in ns, to be a sign of a restart. 0 if the board sends no
        regular reports. `fastest`: how far a wheel's counter may go in a second at the highest speed that is allowed,
        in the counter's unit. 0 if that is not known."""
        self._silent_ns = silent_ns
        self._fastest = fastest * 1e-9
        self.forget()

    def forget(self) -> None:
        """Forget all reports, for example after another port was opened."""
        self._last_ns = self._other_ns = 0
        """`_last_ns`: when the last regular report came. `_other_ns`: when the last report of another kind came."""
        self._learned = (0, 0)
        """The time when the counting of the reports began, and how many have come since then."""
        self._period_ns = 0.0
        """The time between two reports, or 0 if it is not known yet."""
        self._pause: tuple[int, int] | None = None
        """The times when the last pause began and ended. None if there was none, or if it was judged already."""
        self._came = 0
        self._continues = False
        """True if the counters continued from their last values after the pause."""
        self._at: tuple[int, Sequence[float]] | None = None
        self._rate = 0.0
        self._drove = 0

    def heard(self, reports: int, others: int, now_ns: int) -> str:
        """Record how many regular reports, and how many reports of other kinds, were just read."""
        if not self._silent_ns:
            return ""
        if self._pause:
            self._came += reports
            self._last_ns = now_ns if reports else self._last_ns
            return self._judged(*self._pause, now_ns) if now_ns - self._pause[1] >= KEPT_NS else ""
        if not reports:
            self._other_ns = now_ns if others else self._other_ns
            return ""
        last_ns, self._last_ns = self._last_ns, now_ns
        # If the board sends other things during the pause, it is running, and only its reports have stopped.
        alone = self._other_ns - last_ns < self._silent_ns
        if now_ns - last_ns < self._silent_ns:
            self._learn(reports, now_ns)
        elif self._period_ns and alone:
            self._pause, self._came, self._continues = (last_ns, now_ns), reports, False
        else:
            self._learned = (now_ns, 0)
        return ""

    def _learn(self, reports: int, now_ns: int) -> None:
        since_ns, count = self._learned
        if not since_ns:
            self._learned = (now_ns, 0)
            return
        count += reports
        self._learned = (since_ns, count)
        if now_ns - since_ns >= LEARN_NS:
            self._period_ns = (now_ns - since_ns) / count
            self._learned = (now_ns, 0)

    def _judged(self, begun_ns: int, ended_ns: int, now_ns: int) -> str:
        """Judge a pause in the reports. The board has restarted if too many of the reports that were due have not come
        (MISSING). It has not restarted if its counters continued from their last values."""
        missing = (now_ns - begun_ns) / self._period_ns - self._came
        paused = (ended_ns - begun_ns) / self._period_ns
        self._pause, self._learned = None, (now_ns, 0)
        if missing < MISSING * paused or self._continues:
            return ""
        return self._found(f"no report came for {(ended_ns - begun_ns) // MS} ms")

    def counted(self, positions: Sequence[float], t_ns: int) -> str:
        """Check a report of the board's counters."""
        if not positions:
            return ""
        before, self._at = self._at, (t_ns, positions)
        if not before or len(before[1]) != len(positions) or t_ns <= before[0]:
            return ""
        passed_ns = t_ns - before[0]
        moved = max((abs(new - old) for new, old in zip(positions, before[1], strict=True)), default=0.0)
        most, furthest = FASTER * self._rate * passed_ns + CLOSE, max(map(abs, positions), default=0.0)
        # A robot that starts to drive goes much farther than in the time before, so ask for a fall that no wheel can
        # make. Otherwise it would seem to restart whenever it starts close to zero and drives over it.
        if furthest <= most and moved > max(most, LEAST_FALL, FASTER * self._fastest * passed_ns):
            return self._found(COUNTERS)
        self._continues |= moved <= most < furthest
        self._rate = max(FADES * self._rate, moved / passed_ns)
        return ""

    def obeyed(self, *, zeros: bool, told_ns: int) -> str:
        """Check a report of the command that the board obeys. `zeros`: True if the board obeys zero. `told_ns`: since
        when motion has been commanded, or 0 if a zero or a stop was written last."""
        drove, self._drove = self._drove, 0 if zeros else told_ns
        return self._found(OBEYS_ZERO) if zeros and told_ns and drove == told_ns else ""

    def started(self, text: str) -> str:
        """Handle a sign of a start that the board itself sends, for example a text. The sign counts only after the
        first report, because some boards restart when their port is opened."""
        return self._found(text) if self._last_ns or self._at else ""

    def _found(self, sign: str) -> str:
        self.forget()
        return sign
