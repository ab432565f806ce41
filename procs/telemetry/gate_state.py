"""What telemetry goes by of the gate's published state: whether the wheels are told to turn, may turn, are stopped."""

from __future__ import annotations

import msgpack

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.shm.cell import LatestReader

SILENT_NS = 250_000_000
"""The gate publishes at least every 100 ms. One that has been silent for this long is past its lease: the port owner
has stopped the wheels, whatever it said last."""
REST = (0.0, 0.0, 0.0)


class GateState:
    """The newest state. Before the first: motion is disabled, the wheels stand, nothing is latched."""

    __slots__ = ("_found", "_reader", "_seq", "_t_ns", "enabled", "epoch", "latched", "since_ns", "tucks", "velocity")

    def __init__(self, reader: LatestReader) -> None:
        self._reader = reader
        self._found: dict[str, Any] = {}
        self._seq = 0
        self._t_ns = 0
        self.enabled = False
        self.latched = False
        self.epoch = 0
        """Raised by every stop: a latch that came and went between two looks leaves a newer one."""
        self.tucks = False
        """The arm has announced that it goes to its tuck pose."""
        self.velocity = REST
        """m/s forward, m/s left, rad/s counter-clockwise."""
        self.since_ns = 0
        """When this state began, as far as is known."""

    @property
    def commanded(self) -> bool:
        """Whether a velocity other than zero is commanded."""
        return any(self.velocity)

    def read(self, now_ns: int) -> bool:
        """Look for news; True when there is some."""
        entry = self._reader.read()
        news = False
        if entry and entry[0] != self._seq:
            self._seq, self._t_ns = entry[0], entry[1]
            news = self._take(entry[2], entry[1])
        if now_ns - self._t_ns > SILENT_NS and (self.enabled or self.commanded):
            self.enabled = False
            self.velocity = REST
            self.since_ns = now_ns
            news = True
        return news

    def _take(self, payload: bytes, t_ns: int) -> bool:
        try:
            # Kept until the next: its keys are interned strings, and to intern and drop them at each turn has Python
            # build its table of them again every few minutes.
            found = self._found = msgpack.unpackb(payload)
            vx, vy, wz = found["body_vel"]
            velocity = float(vx), float(vy), float(wz)
            enabled, latched, epoch = bool(found["enabled"]), found["estop"] is not None, int(found["epoch"])
            tucks = bool(found["arm"]["tucks"]) if "arm" in found else False
        except (ValueError, KeyError, TypeError):
            return False
        self.tucks = tucks
        self.enabled, self.latched, self.epoch, self.velocity, self.since_ns = enabled, latched, epoch, velocity, t_ns
        return True
