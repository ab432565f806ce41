"""Unasked: how telemetry reacts if the wheels turn although zero is commanded. Pure.

The reaction depends on the state of the gate:

- Motion is enabled: telemetry does nothing, because the gate reads the same fact and disables motion.
- Motion is disabled: telemetry has the stop written again, and reports that somebody pushes the robot or another
  program drives it. If motion was disabled because the wheels turned, and they still turn after still.after_s,
  telemetry latches a stop (UNSTILL).
- A stop is latched: telemetry does nothing until the wheels were once seen still, because the supervisor watches the
  stop until that moment. After that moment, telemetry has the stop written again and reports the motion.

If only an IMU shows the motion, telemetry just logs a note, because a robot that is carried shakes too.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.telemetry.wheels import ARE_STILL, SEEN_BY_REPORTS, THEY_TURN, WheelFact

NOTE_AGAIN_NS = {True: 10_000_000_000, False: 60_000_000_000}
"""The shortest time between two notes that the wheels still turn, in ns. The key is True if the board's reports show
this, and False if only an IMU does."""


class Reaction(Data):
    """What telemetry must do now about wheels that turn."""

    cause: Cause | None
    """The cause of a stop that must be latched, or None."""
    again: bool
    """True if the stop must be written again. This does not latch a stop."""
    note: Note | None


NO_REACTION = Reaction(None, False, None)


class Unasked:
    """Decides the reaction. Call update() at each change of the wheels or of the gate."""

    def __init__(self, after_ns: int) -> None:
        """`after_ns`: how long the wheels may still turn after motion was disabled because they turned. It is also the
        shortest time between two writes of the stop."""
        self._after_ns = after_ns
        self._was_enabled = self._was_unexpected = False
        self._disabled_ns = 0
        """The time when motion was disabled because the wheels turned. 0 if it was not disabled for this reason, or if
        the wheels have stopped since."""
        self._epoch = 0
        self._rested = False
        """True if the wheels have been seen still in the current epoch."""
        self._again_ns = self._noted_ns = 0
        self._noted_turning = False

    def update(self, fact: WheelFact, now_ns: int, *, enabled: bool, latched: bool, epoch: int) -> Reaction:
        """Decide the reaction to the newest fact about the wheels. `epoch`: the current epoch, which every stop
        raises."""
        reported = fact.by == SEEN_BY_REPORTS
        if epoch != self._epoch:
            self._epoch, self._rested = epoch, False
        self._rested = self._rested or fact.does == ARE_STILL
        if self._was_enabled and not (enabled or latched) and self._was_unexpected and reported:
            self._disabled_ns = now_ns
        if enabled or latched or fact.does != THEY_TURN:
            self._disabled_ns = 0
        self._was_enabled, self._was_unexpected = enabled, fact.unexpected
        if not fact.unexpected:
            return self._over(fact, now_ns)
        if enabled or (latched and not self._rested):
            return NO_REACTION
        if self._disabled_ns and now_ns - self._disabled_ns >= self._after_ns:
            self._disabled_ns = 0
            return Reaction(causes.UNSTILL(), False, None)
        again = reported and now_ns - self._again_ns >= self._after_ns
        if again:
            self._again_ns = now_ns
        return Reaction(None, again, self._turning(reported, now_ns))

    def _turning(self, reported: bool, now_ns: int) -> Note | None:
        if self._noted_ns and now_ns - self._noted_ns < NOTE_AGAIN_NS[reported]:
            return None
        self._noted_ns, self._noted_turning = now_ns, True
        if reported:
            text = (
                "the wheels turn although they were told to stop, so the stop is written again: "
                "somebody pushes the robot, or another program drives it"
            )
            return Note("wheels_turn", text, {"state": "turning", "by": "wheels"})
        text = "the robot moves, or is being moved, although it was told to stop"
        return Note("wheels_turn", text, {"state": "turning", "by": "IMU"}, level="info")

    def _over(self, fact: WheelFact, now_ns: int) -> Reaction:
        if not self._noted_turning or fact.does != ARE_STILL:
            return NO_REACTION
        self._noted_turning = False
        return Reaction(
            None, False, Note("wheels_turn", "the wheels are still again", {"state": "still", "by": ""}, level="info")
        )
