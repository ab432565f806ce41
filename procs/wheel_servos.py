"""Decides whether motion must wait for the servo of a wheel, from telemetry's newest report about the servos."""

from __future__ import annotations

from failstop.messages import records
from failstop.policy import servos

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings
    from failstop.shm.cell import LatestReader


class WheelServos:
    """Checks whether motion must wait for a wheel's servo. Costs nothing if no servos turn this robot's wheels."""

    def __init__(self, settings: Settings, health: LatestReader) -> None:
        self._settings = settings
        self._health = health if servos.turn_wheels(settings) else None

    def waited_for(self) -> str:
        """Return what motion must wait for, as text, if a wheel's servo does not answer. Otherwise return an empty
        text."""
        report = self._health.read() if self._health else None
        return servos.waited_for(records.HEALTH.unpack(report[2]), self._settings) if report else ""
