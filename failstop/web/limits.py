"""Limits: how often somebody may ask for something. Pure: the time is an argument."""

from __future__ import annotations

MOST_KEYS = 1024


class Limit:
    """A bucket for each key: `burst` at once, then `per_s`."""

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_s = per_s
        self._burst = burst
        self._left: dict[str, tuple[float, float]] = {}

    def spend(self, key: str, now_s: float) -> bool:
        """True when this one may. `now_s`: a monotonic clock; one that went back gives nothing."""
        left, since_s = self._left.pop(key, (float(self._burst), now_s))
        left = min(float(self._burst), left + max(0.0, now_s - since_s) * self._per_s)
        if len(self._left) >= MOST_KEYS:  # a sender that made up so many names has no bucket worth keeping
            self._left.pop(next(iter(self._left)))
        self._left[key] = (left - 1 if left >= 1 else left), max(now_s, since_s)
        return left >= 1

    def give_back(self, key: str) -> None:
        """Give back the last token that this one took."""
        if key in self._left:
            left, since_s = self._left[key]
            self._left[key] = (min(float(self._burst), left + 1), since_s)
