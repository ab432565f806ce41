"""Repeats: when a stop of the fleet is sent again. Pure; times are monotonic seconds."""

from __future__ import annotations

AGAIN_S = 0.5
"""Time between two sendings of one stop, each with its own date."""
MANY_AGAIN_S = 1.5
"""Time between two sendings while many are missing: every robot answers each of them."""
MANY = 100
"""Missing robots above which they are many."""
LATEST_S = 4.5
"""The longest time between two sendings. Until then a fleet whose answers still come in is not asked again: a
thousand robots that take two seconds to answer would answer twice, and take four."""


class Repeats:
    """The next sending: due at once, before the first one."""

    def __init__(self) -> None:
        self._due_s = self._latest_s = 0.0

    def sent(self, now_s: float, missing: int) -> None:
        """The stop went out, while so many robots had not confirmed it."""
        many = missing > MANY
        self._due_s = now_s + (MANY_AGAIN_S if many else AGAIN_S)
        self._latest_s = now_s + LATEST_S if many else self._due_s

    def heard(self, now_s: float) -> None:
        """A robot told something new."""
        self._due_s = min(self._latest_s, max(self._due_s, now_s + AGAIN_S))

    def due(self, now_s: float) -> bool:
        """True when the stop goes out once more."""
        return now_s >= self._due_s
