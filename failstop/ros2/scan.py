"""Scan: finds out what is wrong with the obstacle sensor: nobody publishes, the type is wrong, or the sensor is silent.
Pure."""

from __future__ import annotations

from collections.abc import Sequence

from failstop.ros2 import words
from failstop.ros2.commanders import NAMELESS, Publisher, wrong_ends
from failstop.ros2.contract import SCAN

NO_SCAN = "no scan"
"""The gate's reason for blocking the wheels if the sensor is silent."""


class ScanWatch:
    """The sensor's publishers, and when its last message arrived."""

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self.needed = True
        """False if the robot drives without a sensor (setting scan.gate). Then it is no problem if no scan arrives."""
        self._heard_ns: int | None = None
        self._publishers: tuple[Publisher, ...] = ()

    def heard(self, now_ns: int) -> None:
        """Note that a message arrived."""
        self._heard_ns = now_ns

    def look(self, publishers: Sequence[Publisher]) -> None:
        """Note the publishers that were found."""
        self._publishers = tuple(publishers)

    def says(self, now_ns: int) -> tuple[str, list[str]]:
        """Returns (what is seen, a list of problems)."""
        if wrong := wrong_ends(SCAN.name, self._publishers, (SCAN.type,), reliable=False):
            return "scan of another type", wrong
        names = ", ".join(dict.fromkeys(publisher.node or NAMELESS for publisher in self._publishers))
        seen = f"scan: {names}" if names else "nobody publishes scan"
        return seen, [missing] if self.needed and (missing := self._missing(names, now_ns)) else []

    def _missing(self, names: str, now_ns: int) -> str:
        """Why no scan arrives. Empty if scans arrive. `names`: the nodes that publish, or empty if none does."""
        if not names:
            return "nobody publishes scan: start the lidar's node, or remap its topic"
        if self._heard_ns is None:
            return f"{names} publishes scan, but has sent nothing yet"
        silent = now_ns - self._heard_ns > self.timeout_s * 1e9
        return f"{names} publishes scan, but is silent" if silent else ""


class ScanLog:
    """Writes two log lines: one when a missing scan stops the wheels, and one when the scan is back. The words are
    those of the ROSOrin's own driver, because people may search logs for them."""

    def __init__(self, now_ns: int) -> None:
        self._begun_ns = now_ns
        self._held = False

    def update(self, blocked: str | None, scan_age_s: float | None, timeout_s: float, now_ns: int) -> str:
        """The line to log now, or "". `blocked`: the gate's reason, which is NO_SCAN only while somebody commands."""
        if blocked == NO_SCAN:
            if self._held:
                return ""
            self._held = True
            return words.HELD.format((now_ns - self._begun_ns) / 1e9 if scan_age_s is None else scan_age_s)
        if self._held and scan_age_s is not None and scan_age_s <= timeout_s:
            self._held = False
            return words.RELEASED
        return ""
