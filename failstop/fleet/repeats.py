"""Repeats: decides when a fleet stop is sent again. Pure. All times are from time.monotonic(), s."""

from __future__ import annotations

AGAIN_S = 0.5
"""The time between two sendings of a fleet stop, s. Each time, the stop is signed with a new date."""
MANY_AGAIN_S = 1.5
"""The time between two sendings of a fleet stop while many robots have not confirmed it, s. It is longer than AGAIN_S,
because every robot answers each time it receives the stop."""
MANY = 100
"""MANY_AGAIN_S applies while more robots than this have not confirmed the stop."""
LATEST_S = 4.5
"""The longest time between two sendings of a stop, s. While many robots have not confirmed it, each new answer
postpones the next sending, up to this limit. A thousand robots need two seconds to answer. If the stop was sent again
meanwhile, they would answer twice, and need four seconds."""


class Repeats:
    """Decides when the stop must be sent. The first sending is due at once."""

    def __init__(self) -> None:
        self._due_s = self._latest_s = 0.0

    def sent(self, now_s: float, missing: int) -> None:
        """Note that the stop was sent, while `missing` robots had not confirmed it."""
        many = missing > MANY
        self._due_s = now_s + (MANY_AGAIN_S if many else AGAIN_S)
        self._latest_s = now_s + LATEST_S if many else self._due_s

    def heard(self, now_s: float) -> None:
        """Note that a robot has reported something new. This may postpone the next sending."""
        self._due_s = min(self._latest_s, max(self._due_s, now_s + AGAIN_S))

    def due(self, now_s: float) -> bool:
        """Return True if the stop must be sent now."""
        return now_s >= self._due_s
