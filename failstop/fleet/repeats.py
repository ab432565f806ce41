"""Repeats: when a fleet stop is sent again. Pure; times are those of time.monotonic(), s."""

from __future__ import annotations

AGAIN_S = 0.5
"""Time between two sendings of one stop, s. Each sending has its own date."""
MANY_AGAIN_S = 1.5
"""Time between two sendings while many robots are missing, s, because every robot answers every sending."""
MANY = 100
"""More missing robots than this are many."""
LATEST_S = 4.5
"""The longest time between two sendings, s. Until then nothing is sent while answers still come in: a thousand robots
take two seconds to answer, and if they had to answer twice, they would take four."""


class Repeats:
    """Knows when the next sending is due; the first one is due at once."""

    def __init__(self) -> None:
        self._due_s = self._latest_s = 0.0

    def sent(self, now_s: float, missing: int) -> None:
        """The stop was sent while this many robots had not confirmed it."""
        many = missing > MANY
        self._due_s = now_s + (MANY_AGAIN_S if many else AGAIN_S)
        self._latest_s = now_s + LATEST_S if many else self._due_s

    def heard(self, now_s: float) -> None:
        """A robot has reported something new."""
        self._due_s = min(self._latest_s, max(self._due_s, now_s + AGAIN_S))

    def due(self, now_s: float) -> bool:
        """True when the stop must be sent again."""
        return now_s >= self._due_s
