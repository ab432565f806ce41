"""Odd reports: makes notes about impossible values in the board's reports. Pure."""

from __future__ import annotations

BATTERY = "battery"
ODD_TEXTS = {
    BATTERY: "the board reports a battery of {value}: no battery has such a voltage, so it counts as not reported",
    "reader": "the reader of this board failed ({value}): what it was reading is lost",
}
ODD_OTHER = "the board reports {what} as {value}: no such value is possible, so it counts as not reported"
BLIND = ", and no low battery stops the robot meanwhile"


class OddReports:
    """Makes one note for each kind of impossible value, however often the value comes."""

    def __init__(self, *, low_battery_stops: bool) -> None:
        self._low_battery_stops = low_battery_stops
        self._noted: set[str] = set()

    def text(self, what: str, value: str) -> str:
        """Return the text of a note about this value, or an empty text if a value of this kind was noted before."""
        if what in self._noted:
            return ""
        self._noted.add(what)
        text = ODD_TEXTS.get(what, ODD_OTHER).format(what=what, value=value)
        return f"{text}{BLIND}" if what == BATTERY and self._low_battery_stops else text
