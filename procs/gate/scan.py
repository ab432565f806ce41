"""The scan gate: a sensor-validity interlock. Software commands move the wheels only while the obstacle sensor
delivers; manual ones are exempt. It blocks without latching: motion resumes by itself, from zero. Pure."""

from __future__ import annotations

from failstop.procs.gate.stamps import believed_ns
from failstop.shm.packing import Note


class ScanGate:
    """When the sensor delivered last, and whether its silence blocks now."""

    __slots__ = ("_blocks", "_timeout_ns", "delivered_ns", "on")

    def __init__(self, timeout_ns: int, *, on: bool) -> None:
        self._timeout_ns = timeout_ns
        self.on = on
        self._blocks = False
        self.delivered_ns = 0
        """When the sensor delivered last; 0: never yet."""

    def deliver(self, t_ns: int, now_ns: int) -> None:
        """The sensor delivered; a stamp from the future is no delivery."""
        self.delivered_ns = max(self.delivered_ns, believed_ns(t_ns, now_ns))

    def silent(self, now_ns: int) -> bool:
        """True when software commands must not move the wheels."""
        return self.on and (not self.delivered_ns or now_ns - self.delivered_ns > self._timeout_ns)

    def silent_ns(self) -> int:
        """When the last delivery stops counting."""
        return self.delivered_ns + self._timeout_ns + 1

    def age_s(self, now_ns: int) -> float | None:
        """Since the last delivery; None when there was none."""
        return (now_ns - self.delivered_ns) * 1e-9 if self.delivered_ns else None

    def note(self, now_ns: int, *, blocks: bool) -> Note | None:
        """What people are told when the block comes or goes, with the sensor's age; else None."""
        if blocks == self._blocks:
            return None
        age_s = self.age_s(now_ns)
        if blocks:
            self._blocks = True
            if age_s is None:
                return Note("scan", "no scan yet: wheels stand", {"state": "silent"})
            return Note("scan", f"no scan for {age_s:.2f} s: wheels stopped", {"state": "silent", "age_s": age_s})
        if self.silent(now_ns):
            return None  # something else holds the wheels now; the sensor is not back
        self._blocks = False
        text = f"scan is back (age {age_s or 0:.2f} s): motion resumes by itself"
        return Note("scan", text, {"state": "back", "age_s": age_s or 0.0}, level="info")
