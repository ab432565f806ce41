"""Hold: makes sure that a person really holds a button for two seconds. It uses the page's messages and the robot's
clock. Pure: times are arguments (time.monotonic()).

The page sends a message when the person presses the button, and then ten messages per second while the button is held.
After two seconds the robot asks the page to confirm the hold. If any message comes too late, the hold fails. So a
frozen page or a slow network can't send a request for a button that was released long ago.
"""

from __future__ import annotations

import dataclasses

HOLD_S = 2.0
GAP_S = 0.6
"""The longest allowed time between two messages about the hold, s. The page sends ten per second."""
SURE_S = 0.6
"""How long the page may take to confirm the hold after the robot has asked, s."""
LATE = "this page or its network was held up, so hold again"
NEWER_STOP = "the robot was stopped again: look at that stop first, then hold again"


@dataclasses.dataclass
class Hold:
    """One hold of a button."""

    verb: str
    identity: str
    """The id that the page gave to this hold."""
    epoch: int
    """The robot's epoch that the page knew when the hold began. It identifies the newest stop that the person could see
    at that time."""
    percent: int | None
    """The requested speed limit, in percent. None for other requests."""
    begun_s: float
    heard_s: float
    enough_s: float | None = None
    """The time at which the button had been held for HOLD_S. None before that."""

    def held(self, now_s: float) -> bool:
        """Note a message that the button is still held. Returns False if the message came too late."""
        gap_s, self.heard_s = now_s - self.heard_s, now_s
        return gap_s <= GAP_S

    def enough(self, now_s: float) -> bool:
        """Return True once, as soon as the button has been held for HOLD_S. The caller must then ask the page to
        confirm the hold."""
        if self.enough_s is not None or now_s - self.begun_s < HOLD_S:
            return False
        self.enough_s = now_s
        return True

    def sure(self, now_s: float) -> bool:
        """Note the page's confirmation of the hold. Returns False if the confirmation was not asked for, or came too
        late."""
        return self.held(now_s) and self.enough_s is not None and now_s - self.enough_s <= SURE_S
