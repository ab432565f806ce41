"""Limits: restricts how often requests are accepted, for example attempts to pair from one address. Pure: times are
arguments."""

from __future__ import annotations

MOST_KEYS = 1024


class Limit:
    """Limits the requests of each key, for example of each network address. A key may make `burst` requests at once.
    After that, it may make `per_s` requests per second (a token bucket)."""

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_s = per_s
        self._burst = burst
        self._left: dict[str, tuple[float, float]] = {}

    def spend(self, key: str, now_s: float) -> bool:
        """Use up one token of this key. Returns False if none is left, so the request must be refused. `now_s`:
        time.monotonic(). If the time went backwards, no tokens are added."""
        left, since_s = self._left.pop(key, (float(self._burst), now_s))
        left = min(float(self._burst), left + max(0.0, now_s - since_s) * self._per_s)
        if len(self._left) >= MOST_KEYS:  # drop the oldest key, so that invented keys can't fill the memory
            self._left.pop(next(iter(self._left)))
        self._left[key] = (left - 1 if left >= 1 else left), max(now_s, since_s)
        return left >= 1

    def give_back(self, key: str) -> None:
        """Give back the token that the last request of this key used."""
        if key in self._left:
            left, since_s = self._left[key]
            self._left[key] = (min(float(self._burst), left + 1), since_s)
