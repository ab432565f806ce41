"""Hold: makes sure that a button is really held for two seconds, by messages of the page and the robot's clock. Pure:
the times are arguments (time.monotonic()).

The page reports that the hold begins, and then again and again that it lasts. When it has lasted long enough, the robot
asks, and the page must confirm that the button is still held. Each message must come in time. So a page that was held
up, or a network that delivers late, can't make a request for a button that nobody holds any more.
"""

from __future__ import annotations

import dataclasses

HOLD_S = 2.0
GAP_S = 0.6
"""The longest time between two messages that the button is still held, s. The page sends ten per second."""
SURE_S = 0.6
"""How long the page may take to confirm that the button is still held, s."""
LATE = "this page or its network was held up, so hold again"
NEWER_STOP = "the robot was stopped again: look at that stop first, then hold again"


@dataclasses.dataclass
class Hold:
    """One hold of a button."""

    verb: str
    identity: str
    """The page's id of this hold."""
    epoch: int
    """The epoch that the person has seen, which stands for the newest stop that the page knew."""
    percent: int | None
    """The speed limit that is asked for, percent."""
    begun_s: float
    heard_s: float
    enough_s: float | None = None
    """When the button had been held long enough."""

    def held(self, now_s: float) -> bool:
        """The page reports that the button is still held. False if the report comes too late."""
        gap_s, self.heard_s = now_s - self.heard_s, now_s
        return gap_s <= GAP_S

    def enough(self, now_s: float) -> bool:
        """True once, when the button was held long enough, so that the page must be asked."""
        if self.enough_s is not None or now_s - self.begun_s < HOLD_S:
            return False
        self.enough_s = now_s
        return True

    def sure(self, now_s: float) -> bool:
        """The page confirms that the button is still held. False if the robot has not asked, or asked too long ago."""
        return self.held(now_s) and self.enough_s is not None and now_s - self.enough_s <= SURE_S
