"""Buzzer tones: what sounds on a latch and on a change of the gamepad's mode. Pure."""

from __future__ import annotations

from failstop.board.codec import buzzer
from failstop.procs.telemetry import pad

OFF_MS = 100
"""Between two beeps and after the last: an off time of 0 left a buzzer sounding forever."""

LATCH = buzzer(1000, 400, OFF_MS, 2)
"""Two long low beeps."""
MODES = {
    pad.LOCKED: buzzer(1500, 100, OFF_MS, 1),
    pad.DRIVE: buzzer(2500, 100, OFF_MS, 2),
    pad.JOINT: buzzer(2500, 100, OFF_MS, 3),
}
"""One short beep: locked; two short high ones: drive; three: joint."""
TUCK = buzzer(2000, 50, OFF_MS, 4)
"""Four short ones: the arm is about to move by itself."""


class Tones:
    """Remembers what it last saw, so that a tone sounds on the change alone; off, it never sounds."""

    __slots__ = ("_latched", "_mode", "_on", "_tucks")

    def __init__(self, *, on: bool) -> None:
        self._on = on
        self._latched: bool | None = None
        self._mode = pad.LOCKED
        self._tucks = False

    def follow(self, latched: bool, mode: int, *, tucks: bool = False) -> bytes:
        """The frame to sound now, or none. A latch also locks the pad: then its tone alone is heard. What is
        latched at the start was told by whoever was there when it happened."""
        latches = latched and self._latched is False
        changed = mode != self._mode
        announced = tucks and not self._tucks
        self._latched = latched
        self._mode = mode
        self._tucks = tucks
        if not self._on:
            return b""
        if latches:
            return LATCH
        if announced:
            return TUCK
        return MODES[mode] if changed and not latched else b""
