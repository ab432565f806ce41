"""Charger detection: a step of the battery voltage while nothing loads it. Pure."""

from __future__ import annotations

UNKNOWN = 0
PLUGGED = 1
UNPLUGGED = 2
"""Indices of records.PLUGGED."""

WINDOW_NS = 8_000_000_000
RECENT_NS = 2_000_000_000
"""The firmware averages: a step takes about 3 s to show fully, so the newest readings are no part of the base line."""
SETTLE_NS = 3_000_000_000
"""Motor load moves the voltage by up to 170 mV, and so does its end."""
MOST_READINGS = 64
"""About one a second comes; a flood must not make each of them dear."""


class Charger:
    """Remembers the last seconds of readings. Measured on the robot: plugging in is +249 mV, unplugging -226 mV."""

    __slots__ = ("_disabled_since_ns", "_readings", "_step_mv", "state")

    def __init__(self, step_mv: float, state: int = UNKNOWN) -> None:
        """`state`: what was known before a restart."""
        self._step_mv = step_mv
        self._readings: list[tuple[int, int]] = []
        self._disabled_since_ns: int | None = None
        self.state = state

    def follow(self, enabled: bool, now_ns: int) -> None:
        """Motion is enabled or disabled."""
        if enabled:
            self._disabled_since_ns = None
        elif self._disabled_since_ns is None:
            self._disabled_since_ns = now_ns

    def take(self, millivolts: int, t_ns: int) -> bool:
        """One reading. True when it changed `state`."""
        known = [reading for reading in self._readings if t_ns - reading[0] <= WINDOW_NS][-MOST_READINGS:]
        self._readings = [*known, (t_ns, millivolts)]
        base_mv = _median([mv for read_ns, mv in known if t_ns - read_ns > RECENT_NS])
        since_ns = self._disabled_since_ns
        if base_mv is None or since_ns is None or t_ns - since_ns <= SETTLE_NS:
            return False
        step_mv = millivolts - base_mv
        if abs(step_mv) < self._step_mv:
            return False
        was, self.state = self.state, PLUGGED if step_mv > 0 else UNPLUGGED
        return self.state != was


def _median(values: list[int]) -> float | None:
    if not values:
        return None
    values.sort()
    middle = len(values) // 2
    return values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2
