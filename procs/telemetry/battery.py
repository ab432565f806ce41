"""The battery: stops the robot when the voltage is low, detects the charger from steps in the voltage, and makes the
lines of the battery log. Pure."""

from __future__ import annotations

from time import gmtime, strftime

from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings

UNDECIDED, PLUGGED_IN, UNPLUGGED = range(3)
"""The states of the charger, as indices of records.PLUGGED."""

LOW_READINGS = 5
LOW_NS = 5_000_000_000
"""The robot stops if all readings have been low for LOW_NS, and they are at least LOW_READINGS. The motors pull the
voltage down while they start, and some boards send 100 readings in that second."""
CHARGED_PERCENT = 110
CHARGED_NS = 60_000_000_000
"""A battery counts as charged if all readings of CHARGED_NS are at least CHARGED_PERCENT of battery.stop_mv.
The voltage of an empty battery also rises when the motors stop, but only by a few percent. A charge raises a lithium
cell from about 3.4 V to 4.2 V. The state of the charger is not used here, because with large motors the voltage jumps
at each stop as if a charger were plugged in."""
SWAPPED_NS = 5_000_000_000
"""If the board has reported no battery for this long, the battery may have been swapped. A charged battery of a flat
chemistry may be below CHARGED_PERCENT."""
SWAPPED_GAPS = 3
"""The battery counts as swapped only after a pause that is this many times the longest of the last pauses, because some
boards report their battery seldom."""

JUMP_WINDOW_NS = 8_000_000_000
RECENT_NS = 2_000_000_000
"""A new reading is compared only with earlier ones from the last JUMP_WINDOW_NS, but not with those from the last
RECENT_NS. The newest readings may already show a part of a step, because the firmware averages the voltage over a few
seconds."""
SETTLE_NS = 3_000_000_000
"""How long motion must have been disabled, in ns, before a step in the voltage counts as the charger's. When the motors
begin or end to draw current, the voltage also makes a step, of up to 170 mV."""
KEPT_APART_NS = 250_000_000
"""The shortest time between two readings that are kept. Some boards send 100 a second, and to keep the readings of
JUMP_WINDOW_NS would be much work."""

HEADER = "unix_s,battery_mv,enabled\n"
"""The first line of every log file. `enabled` is 1 while motion is enabled."""


class LowBattery:
    """Stops the robot if the voltage stays below the setting battery.stop_mv, once until the battery has been charged
    or swapped. If the setting is -1, nothing is stopped."""

    def __init__(self, settings: Settings) -> None:
        self._least_mv = settings["battery.stop_mv"]
        self.stops = self._least_mv >= 0
        """True if a low battery stops the robot."""
        self._low_since: tuple[int, int] | None = None
        """When the first of the low readings in a row came, and how many there are. None if the last one was not
        low."""
        self._high_since_ns: int | None = None
        self._has_stopped = False
        """True from a stop until the battery has been charged or swapped."""
        self._last_ns: int | None = None
        self._gap_ns = 0
        """The longest of the last pauses between two readings, in ns. At each reading it is halved, so that it is
        forgotten with time."""

    def add(self, millivolts: int, t_ns: int) -> Cause | None:
        """Add a reading. Returns the cause of a stop if the voltage has just been low for long enough, otherwise
        None."""
        gap_ns = 0 if self._last_ns is None else t_ns - self._last_ns
        if gap_ns >= max(SWAPPED_NS, SWAPPED_GAPS * self._gap_ns):
            self._low_since, self._high_since_ns, self._has_stopped = None, None, False
        self._last_ns, self._gap_ns = t_ns, max(gap_ns, self._gap_ns // 2)
        if millivolts >= self._least_mv:
            self._low_since = None
            self._look_for_charge(millivolts, t_ns)
            return None
        self._high_since_ns = None
        since_ns, count = self._low_since or (t_ns, 0)
        self._low_since = since_ns, count + 1
        if self._has_stopped or count + 1 < LOW_READINGS or t_ns - since_ns < LOW_NS:
            return None
        self._has_stopped = True
        return causes.BATTERY(millivolts / 1000)

    def _look_for_charge(self, millivolts: int, t_ns: int) -> None:
        if 100 * millivolts < CHARGED_PERCENT * self._least_mv:
            self._high_since_ns = None
        elif self._high_since_ns is None:
            self._high_since_ns = t_ns
        elif t_ns - self._high_since_ns >= CHARGED_NS:
            self._has_stopped = False


class Charger:
    """Detects the charger from a step in the voltage while the motors put no load on it. On the robot, the step is +249
    mV for plugging in and -226 mV for unplugging."""

    def __init__(self, settings: Settings) -> None:
        self._step_mv = settings["battery.step_mv"]
        self._readings: list[tuple[int, int]] = []
        self._disabled_since_ns: int | None = None
        self.state = UNDECIDED

    def follow(self, enabled: bool, now_ns: int) -> None:
        if enabled:
            self._disabled_since_ns = None
        elif self._disabled_since_ns is None:
            self._disabled_since_ns = now_ns

    def add(self, millivolts: int, t_ns: int) -> bool:
        """Add a reading. Returns True if it has changed `state`."""
        known = [reading for reading in self._readings if t_ns - reading[0] <= JUMP_WINDOW_NS]
        if not known or t_ns - known[-1][0] >= KEPT_APART_NS:
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
    """Makes one line of the battery log per period (battery.log_s), from the first reading that comes when the line is
    due."""

    def __init__(self, settings: Settings) -> None:
        self._period_ns = settings.ns("battery.log_s")
        self._on = settings.on("battery.log")
        self._due_ns: int | None = None

    def add(self, millivolts: int, enabled: bool, t_ns: int, unix_s: float) -> tuple[str, str] | None:
        """Add a reading. Returns (file name, line) if a line is due, otherwise None. There is one file per day, in
        UTC."""
        if not self._on or (self._due_ns is not None and t_ns < self._due_ns):
            return None
        # Readings come every 1.05 s. If each line were due one period after a late reading, lines would be 10.5 s
        # apart.
        due_ns = (t_ns if self._due_ns is None else self._due_ns) + self._period_ns
        self._due_ns = due_ns if due_ns > t_ns else t_ns + self._period_ns
        return f"battery-{strftime('%Y-%m-%d', gmtime(unix_s))}.csv", f"{unix_s:.1f},{millivolts},{int(enabled)}\n"
