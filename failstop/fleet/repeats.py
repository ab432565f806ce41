"""Repeats: decides when a fleet stop is sent again. Pure; times are those of time.monotonic(), s."""

from __future__ import annotations

AGAIN_S = 0.5
"""The time until a stop is sent again, s. Each sending has its own date."""
MANY_AGAIN_S = 1.5
"""The time until a stop is sent again while many robots are missing, s. It is longer, because every robot answers every
sending."""
MANY = 100
"""If more robots than this are missing, they count as many."""
LATEST_S = 4.5
"""The longest time until a stop is sent again, s. While answers still arrive, sending it again is postponed up to this
time. A thousand robots take two seconds to answer, and they would take four if they had to answer twice."""


class Repeats:
    """Knows when the stop must be sent again. The first time is at once."""

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
        """True if the stop must be sent now."""
        return now_s >= self._due_s
