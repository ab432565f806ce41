"""Hold: a button that is held for two seconds, by the word of the page and by the robot's clock. Pure: the times are
arguments, of a monotonic clock.

The page says when the hold begins, and again and again that it lasts. The robot says when that was long enough, and the
page, that it lasts even now. Each comes within a bound, so that neither a page that was held up nor a network that
delivers late can ask for what nobody holds any more.
"""

from __future__ import annotations

import dataclasses

HOLD_S = 2.0
GAP_S = 0.6
"""The page says ten times a second that it is held still; it takes as long as this to do so at most."""
SURE_S = 0.6
"""How long the page has to say that it lasts even now."""
LATE = "this page or its network was held up, so hold again"
NEWER_STOP = "the robot was stopped again: look at that stop first, then hold again"


@dataclasses.dataclass
class Hold:
    """One hold."""

    verb: str
    identity: str
    """The page's name for it."""
    epoch: int
    """The epoch that the person has seen: the newest stop of which the page knew."""
    percent: int | None
    """The wanted limit."""
    begun_s: float
    heard_s: float
    enough_s: float | None = None
    """When it had lasted long enough."""

    def held(self, now_s: float) -> bool:
        """It lasts, says the page; False when that comes too late."""
        gap_s, self.heard_s = now_s - self.heard_s, now_s
        return gap_s <= GAP_S

    def enough(self, now_s: float) -> bool:
        """True once: it has lasted long enough, and the page is to be asked."""
        if self.enough_s is not None or now_s - self.begun_s < HOLD_S:
            return False
        self.enough_s = now_s
        return True

    def sure(self, now_s: float) -> bool:
        """It lasts even now, says the page; False where nobody has asked it, or long ago."""
        return self.held(now_s) and self.enough_s is not None and now_s - self.enough_s <= SURE_S
