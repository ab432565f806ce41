"""Keys: turns the bytes from a terminal into the velocity for the key that is held. Pure, because the time is an
argument.

A terminal sends a key's bytes again and again while the key is held, and nothing when it is released. If several keys
are held, it repeats only the last one. Each repeat becomes one command, and the service obeys a command for the command
timeout (0.3 s). Only these commands keep the wheels turning. So the robot stops when the bytes end. That happens, for
example, when the key is released, the connection is lost, or a program is suspended.

If you press a key, the robot drives for one command timeout. Then the wheels stop until the terminal begins to repeat
the key (after 250 to 660 ms). So a tap moves the robot a little. When you release a key, the timeout counts from its
last repeat.
"""

from __future__ import annotations

import re
from codecs import getincrementaldecoder

SPACE = " "
CTRL_D = "\x04"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_PASTED = {"200": True, "201": False}
"""The numbers of two escape sequences. A terminal that was asked to mark pasted text sends one before the text (True),
and the other after the text (False)."""
_LONGEST = 64
"""No escape sequence is longer than this many characters. Something longer is noise."""
_TOKEN = re.compile(r"\x1b\[([ -?]*)([@-~]|(?=[^ -~]))|\x1bO(.)|([^\x1b]|\x1b(?=[^\[O]))", re.DOTALL)
"""Matches one of three things: a sequence `CSI parameters final`, which may be cut off by another character; an arrow
key in application mode; or a single character."""

Velocity = tuple[float, float, float]


class KeyDecoder:
    """Decodes a terminal's bytes into keys. A key is a character in lower case or the name of an arrow, such as `up`.
    If only the first part of an escape sequence has arrived, the decoder keeps it until the rest arrives, however long
    that takes. Otherwise the last letter of an arrow key's sequence would count as a key, and move the robot in a wrong
    direction. For this reason the escape key is recognized only when another key follows."""

    def __init__(self) -> None:
        self._text = getincrementaldecoder("utf-8")("ignore")
        self._rest = ""
        self._pasting = False

    def feed(self, data: bytes) -> list[str]:
        """Add bytes, and return the keys that are complete. Keys in pasted text are left out."""
        rest = self._rest + self._text.decode(data)
        found: list[str] = []
        while (token := _TOKEN.match(rest)) or len(rest) >= _LONGEST:
            rest = rest[token.end() if token else 1 :]
            parameters, final, arrow, character = token.groups() if token else (None, None, None, None)
            if final == "~" and parameters in _PASTED:
                self._pasting = _PASTED[parameters]
            key = character.lower() if character else _ARROWS.get(final or arrow or "", "")
            if key and not self._pasting:
                found.append(key)
        self._rest = rest
        return found


AXES: dict[str, Velocity] = {
    **dict.fromkeys(("w", "up"), (1.0, 0.0, 0.0)),
    **dict.fromkeys(("s", "down"), (-1.0, 0.0, 0.0)),
    **dict.fromkeys(("a", "left"), (0.0, 0.0, 1.0)),
    **dict.fromkeys(("d", "right"), (0.0, 0.0, -1.0)),
    "j": (0.0, 1.0, 0.0),
    "l": (0.0, -1.0, 0.0),
}
"""The keys that move the robot, each with its direction: forward, to the left, and counter-clockwise."""
COMMAND_S = 0.3
"""How long one command is valid by default, in seconds (setting gate.command_timeout_s)."""
ENDS_S = 0.35
"""A key counts as released this many seconds after its last repeat. Usually the service's command timeout stops the
wheels earlier. If the settings have a longer timeout, the wheels stop because teleop then sends a command of zero."""
LONGEST_DELAY_S = 0.8
"""A terminal begins to repeat a held key before this time, in seconds."""
REPEAT_S = 0.15
"""Two repeats of a held key are at most this far apart, in seconds."""
NO_VELOCITY = (0.0, 0.0, 0.0)
MOST_AT_ONCE = 5
"""The largest number of motion keys that one read may contain. A terminal does not send more keys than this between two
reads. If a read has more, the network has delayed the keys. Delayed keys are old, so they do not move the robot."""


class Hold:
    """Uses the repeats of a motion key to decide whether the key is still held, and which command to send."""

    def __init__(self) -> None:
        self.active = False
        """True while a motion key is held."""
        self.jerks = False
        """True if the wheels stop for a moment after each press, although the key is held. This happens if the terminal
        repeats the key for the first time only after the command has expired. This is known only after the key's second
        repeat, because until then the person may have tapped the key twice."""
        self._until_s = 0.0
        """When the held key counts as released if the terminal sends no further repeat (same clock as `now_s`)."""
        self._last = ("", 0.0)
        """The last motion key, and when it came."""
        self._late = False
        """True if the last key may have been a late first repeat. It is the same key as the key before it, and it came
        after that key's command had expired, but within LONGEST_DELAY_S."""

    def pressed(self, keys: list[str], now_s: float) -> Velocity | None:
        """The command to send after `keys` were typed. `keys` is empty if no key was typed. Each axis of the command is
        between -1 and 1. Returns None if there is nothing to send."""
        moving = [key for key in keys if key in AXES]
        if len(moving) > MOST_AT_ONCE or (not moving and now_s >= self._until_s):
            return self.let_go()
        if not moving:
            return None
        key, (last, last_s) = moving[-1], self._last
        again_s = now_s - last_s if key == last else LONGEST_DELAY_S
        self.jerks |= self._late and again_s <= REPEAT_S
        self._late = COMMAND_S < again_s < LONGEST_DELAY_S
        self._last = (key, now_s)
        self.active, self._until_s = True, now_s + ENDS_S
        return AXES[key]

    def let_go(self) -> Velocity | None:
        """Forget the held key. Returns zero velocity if a key was held, because teleop must then send a command of
        zero. Returns None if no key was held."""
        was_active, self.active = self.active, False
        return NO_VELOCITY if was_active else None
