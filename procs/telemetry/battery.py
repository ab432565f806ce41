"""The battery: a low one stops the robot, a step of its voltage is the charger, a log has a line now and then. Pure."""

from __future__ import annotations

from time import gmtime, strftime

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings

UNDECIDED, PLUGGED_IN, UNPLUGGED = range(3)
"""Indices of records.PLUGGED."""

LOW_READINGS = 5
"""In a row, about one a second: the motors pull the voltage down when they start."""

JUMP_WINDOW_NS = 8_000_000_000
RECENT_NS = 2_000_000_000
"""The firmware averages: a step takes about 3 s to show fully, so the newest readings are no part of the base line."""
SETTLE_NS = 3_000_000_000
"""Motor load moves the voltage by up to 170 mV, and so does its end."""
MOST_READINGS = 64
"""About one a second comes; a flood must not make each of them dear."""

HEADER = "unix_s,battery_mv,enabled\n"
"""First line of every file of the log; `enabled` is 1 while the wheels are."""


class LowBattery:
    """Counts the readings in a row that were below the setting's; -1: none ever is."""

    def __init__(self, settings: Settings) -> None:
        self._least_mv = settings["battery.stop_mv"]
        self.stops = self._least_mv >= 0
        """The setting is on."""
        self._low = 0

    def take(self, millivolts: int) -> Cause | None:
        """The cause of a stop that this reading is, or None: once, until the voltage has been above again."""
        self._low = self._low + 1 if millivolts < self._least_mv else 0
        return causes.BATTERY(millivolts / 1000) if self._low == LOW_READINGS else None


class Charger:
    """A step of the voltage while nothing loads it: on the robot +249 mV for plugging in, -226 mV for unplugging."""

    def __init__(self, settings: Settings, state: int = UNDECIDED) -> None:
        """`state`: what was known before a restart."""
        self._step_mv = settings["battery.step_mv"]
        self._readings: list[tuple[int, int]] = []
        self._disabled_since_ns: int | None = None
        self.state = state

    def follow(self, enabled: bool, now_ns: int) -> None:
        if enabled:
            self._disabled_since_ns = None
        elif self._disabled_since_ns is None:
            self._disabled_since_ns = now_ns

    def take(self, millivolts: int, t_ns: int) -> bool:
        """One reading. True when it changed `state`."""
        known = [reading for reading in self._readings if t_ns - reading[0] <= JUMP_WINDOW_NS][-MOST_READINGS:]
        self._readings = [*known, (t_ns, millivolts)]
        base = sorted(mv for read_ns, mv in known if t_ns - read_ns > RECENT_NS)
        since_ns = self._disabled_since_ns
        if not base or since_ns is None or t_ns - since_ns <= SETTLE_NS:
            return False
        step_mv = millivolts - (base[(len(base) - 1) // 2] + base[len(base) // 2]) / 2  # from their median
        if abs(step_mv) < self._step_mv:
            return False
        was, self.state = self.state, PLUGGED_IN if step_mv > 0 else UNPLUGGED
        return self.state != was


class BatteryLog:
    """One line a period, at the first reading when it is due."""

    def __init__(self, settings: Settings) -> None:
        self._period_ns = settings.ns("battery.log_s")
        self._on = settings.on("battery.log")
        self._due_ns: int | None = None

    def take(self, millivolts: int, enabled: bool, t_ns: int, unix_s: float) -> tuple[str, str] | None:
        """One reading. Returns (file name, line) when a line is due; the file is the day's, in UTC."""
        if not self._on or (self._due_ns is not None and t_ns < self._due_ns):
            return None
        # Readings come every 1.05 s: counted from the reading that was late, the lines would be 10.5 s apart.
        due_ns = (t_ns if self._due_ns is None else self._due_ns) + self._period_ns
        self._due_ns = due_ns if due_ns > t_ns else t_ns + self._period_ns
        return f"battery-{strftime('%Y-%m-%d', gmtime(unix_s))}.csv", f"{unix_s:.1f},{millivolts},{int(enabled)}\n"
