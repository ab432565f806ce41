"""The battery: stops the robot when the voltage is low, detects the charger by steps of the voltage, and makes the
lines of a log. Pure."""

from __future__ import annotations

from time import gmtime, strftime

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings

UNDECIDED, PLUGGED_IN, UNPLUGGED = range(3)
"""Indices of records.PLUGGED."""

LOW_READINGS = 5
"""How many low readings in a row stop the robot. One comes about each second. A single one proves nothing, because the
motors pull the voltage down when they start."""

JUMP_WINDOW_NS = 8_000_000_000
RECENT_NS = 2_000_000_000
"""How old a reading must be to count for the voltage before a step. The firmware averages, so a step takes about 3 s to
show fully."""
SETTLE_NS = 3_000_000_000
"""How long motion must have been disabled before steps count, because the load of the motors, and its end, move the
voltage by up to 170 mV."""
MOST_READINGS = 64
"""How many readings are kept. About one comes each second; the limit keeps the work small if a flood of readings
comes."""

HEADER = "unix_s,battery_mv,enabled\n"
"""First line of every file of the log; `enabled` is 1 while motion is enabled."""


class LowBattery:
    """Counts readings in a row that are below the setting. -1 in the setting turns it off."""

    def __init__(self, settings: Settings) -> None:
        self._least_mv = settings["battery.stop_mv"]
        self.stops = self._least_mv >= 0
        """True if the setting is on."""
        self._low = 0

    def add(self, millivolts: int) -> Cause | None:
        """Add a reading. Returns the cause of a stop, or None. The cause comes only once, until the voltage has been
        above the limit again."""
        self._low = self._low + 1 if millivolts < self._least_mv else 0
        return causes.BATTERY(millivolts / 1000) if self._low == LOW_READINGS else None


class Charger:
    """Detects a step of the voltage while no motor loads it: on the robot +249 mV for plugging in, -226 mV for
    unplugging."""

    def __init__(self, settings: Settings, state: int = UNDECIDED) -> None:
        """`state`: the state known before a restart."""
        self._step_mv = settings["battery.step_mv"]
        self._readings: list[tuple[int, int]] = []
        self._disabled_since_ns: int | None = None
        self.state = state

    def follow(self, enabled: bool, now_ns: int) -> None:
        if enabled:
            self._disabled_since_ns = None
        elif self._disabled_since_ns is None:
            self._disabled_since_ns = now_ns

    def add(self, millivolts: int, t_ns: int) -> bool:
        """Add a reading. True when it changed `state`."""
        known = [reading for reading in self._readings if t_ns - reading[0] <= JUMP_WINDOW_NS][-MOST_READINGS:]
        self._readings = [*known, (t_ns, millivolts)]
        base = sorted(mv for read_ns, mv in known if t_ns - read_ns > RECENT_NS)
        since_ns = self._disabled_since_ns
        if not base or since_ns is None or t_ns - since_ns <= SETTLE_NS:
            return False
        step_mv = millivolts - (base[(len(base) - 1) // 2] + base[len(base) // 2]) / 2  # compared with their median
        if abs(step_mv) < self._step_mv:
            return False
        was, self.state = self.state, PLUGGED_IN if step_mv > 0 else UNPLUGGED
        return self.state != was


class BatteryLog:
    """The battery log: one line per period, made at the first reading after it is due."""

    def __init__(self, settings: Settings) -> None:
        self._period_ns = settings.ns("battery.log_s")
        self._on = settings.on("battery.log")
        self._due_ns: int | None = None

    def add(self, millivolts: int, enabled: bool, t_ns: int, unix_s: float) -> tuple[str, str] | None:
        """Add a reading. Returns (file name, line) when a line is due; there is a file for each day, in UTC."""
        if not self._on or (self._due_ns is not None and t_ns < self._due_ns):
            return None
        # Readings come every 1.05 s. If the next line were due after the late reading, lines would be 10.5 s apart.
        due_ns = (t_ns if self._due_ns is None else self._due_ns) + self._period_ns
        self._due_ns = due_ns if due_ns > t_ns else t_ns + self._period_ns
        return f"battery-{strftime('%Y-%m-%d', gmtime(unix_s))}.csv", f"{unix_s:.1f},{millivolts},{int(enabled)}\n"
