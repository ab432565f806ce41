"""What of the board's reports stops the robot: buttons, keys, a low battery. Pure."""

from __future__ import annotations

from failstop.policy import causes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause

PRESSES = frozenset((0x01, 0x02, 0x04, 0x20, 0x40, 0x80))
"""Key events that mean that a finger is or was on the key; releases (0x08, 0x10) are not."""


LOW_READINGS = 5
"""In a row, about one a second: the motors pull the voltage down when they start."""


class Noticer:
    """Remembers the pad's last buttons, so that a held one is one request. A button stops on its first frame: real
    taps last one frame only, so nothing may wait for a second."""

    __slots__ = ("_held", "_low", "_low_mv", "_mode", "_stop_key")

    def __init__(self, mode_button: int, stop_key: int, low_mv: float = -1) -> None:
        """`low_mv`: a battery below it stops the robot; -1: none does."""
        self._mode = mode_button
        self._stop_key = stop_key
        self._low_mv = low_mv
        self._low = 0
        """Readings in a row that were below."""
        self._held = 0

    def pad(self, buttons: int) -> Cause | None:
        """The cause of a stop that this pad frame is, or None."""
        pressed = buttons & ~self._held & ~self._mode
        self._held = buttons
        return causes.BUTTON(pressed) if pressed else None

    def forget_held(self) -> None:
        """The pad was silent: a button that was held then must not mask the next tap."""
        self._held = 0

    def key(self, key: int, event: int) -> Cause | None:
        """The cause of a stop that this key event is, or None."""
        return causes.KEY(key) if key == self._stop_key and event in PRESSES else None

    def battery(self, millivolts: int) -> Cause | None:
        """The cause of a stop that this reading is, or None: once, until the voltage has been above again."""
        self._low = self._low + 1 if millivolts < self._low_mv else 0
        return causes.BATTERY(millivolts / 1000) if self._low == LOW_READINGS else None
