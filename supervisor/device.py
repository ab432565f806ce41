"""Device: when the board's port went and came back, told once each, by whichever sign is seen first."""

from __future__ import annotations

from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.slot import Entry
    from failstop.supervisor.events import Events


EARLIER_NS = 20_000_000
"""A port owner without a port turns every 5 ms."""


class Device:
    """The port as people know it."""

    __slots__ = ("_absent_ns", "_changed_ns", "_events", "_lost")

    def __init__(self, events: Events, now_ns: int) -> None:
        """It is there."""
        self._events = events
        self._lost = False
        self._changed_ns = now_ns
        self._absent_ns = 0

    def may_be_opened(self, there: bool, beat_ns: int, now_ns: int) -> bool:
        """True when a port owner without a port that beat last at `beat_ns` may be in the midst of opening it: not
        while there is no device (`there`), nor when it was silent before the device was back."""
        if not there:
            self._absent_ns = now_ns
        return beat_ns >= self._absent_ns - EARLIER_NS

    def follow(self, entry: Entry | None) -> None:
        """The port owner's record. One from before the last change says nothing new: a hang-up may be seen here
        before the port owner has seen it."""
        if entry is None:
            return
        _, since_ns, state, path = records.unpack_port(entry[2])
        if since_ns <= self._changed_ns:
            return
        if state == records.PORT_LOST:
            self.lost(path, since_ns)
        elif state == records.PORT_OPEN:
            self.back(path, since_ns)

    def lost(self, path: str, now_ns: int) -> None:
        """It is gone."""
        if not self._lost:
            self._lost, self._changed_ns = True, now_ns
            text = f"{path} is gone; the stop is written the moment it is back; wheels that turn: POWER SWITCH"
            self._events.tell("device_lost", text, {"path": path})

    def back(self, path: str, now_ns: int) -> None:
        """It is there again."""
        if self._lost:
            away_s = (now_ns - self._changed_ns) / 1e9
            self._lost, self._changed_ns = False, now_ns
            text = f"{path} is back after {away_s:.1f} s; the stop is written"
            self._events.tell("device_back", text, {"path": path, "away_s": round(away_s, 3)})
