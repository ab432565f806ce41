"""The battery log: which line is due when, and in which file. Pure; state_files.py writes it."""

from __future__ import annotations

from time import gmtime, strftime

HEADER = "unix_s,battery_mv,enabled\n"
"""First line of every file; `enabled` is 1 while the wheels are."""


class BatteryLog:
    """One line a period, at the first reading when it is due."""

    __slots__ = ("_due_ns", "_on", "_period_ns")

    def __init__(self, period_s: float, *, on: bool) -> None:
        self._period_ns = round(period_s * 1e9)
        self._on = on
        self._due_ns: int | None = None

    def take(self, millivolts: int, enabled: bool, t_ns: int, unix_s: float) -> tuple[str, str] | None:
        """One reading. Returns (file name, line) when a line is due; the file is the day's, in UTC: a day has no
        second half past two."""
        if not self._on or (self._due_ns is not None and t_ns < self._due_ns):
            return None
        # Readings come every 1.05 s: counted from the reading that was late, the lines would be 10.5 s apart.
        due_ns = (t_ns if self._due_ns is None else self._due_ns) + self._period_ns
        self._due_ns = due_ns if due_ns > t_ns else t_ns + self._period_ns
        return f"battery-{strftime('%Y-%m-%d', gmtime(unix_s))}.csv", f"{unix_s:.1f},{millivolts},{int(enabled)}\n"
