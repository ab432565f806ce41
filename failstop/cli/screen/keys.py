"""Keys: from the bytes of a terminal to the velocity that a held key asks for. Pure: the time is an argument.

A terminal sends the bytes of a key, again and again while it is held, and nothing when it is released; of several keys
it repeats the last one alone. A command goes out with each of these and counts for the service's command timeout
(0.3 s); nothing else keeps the wheels turning. So whatever ends the bytes - the key's release, a dead connection, a
stopped program - ends the driving. A press drives for one command timeout, then the wheels stand until the terminal's
repeats begin (after 250 to 660 ms): a tap is a nudge, and a release counts from the last repeat on.
"""

from __future__ import annotations

import re
from codecs import getincrementaldecoder

SPACE = " "
CTRL_D = "\x04"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_PASTED = {"200": True, "201": False}
"""Marks of what is pasted, its begin and its end, by a terminal that has been asked for them."""
_LONGEST = 64
"""No sequence is longer; what looks like one is noise."""
_TOKEN = re.compile(r"\x1b\[([ -?]*)([@-~]|(?=[^ -~]))|\x1bO(.)|([^\x1b]|\x1b(?=[^\[O]))", re.DOTALL)
"""`CSI parameters final`, which something else may cut off; an arrow of the application mode; a character."""

Velocity = tuple[float, float, float]


class KeyDecoder:
    """Bytes in, keys out: a character in lower case, or the name of an arrow. Half a sequence waits for the rest,
    however long: the end of an arrow key's is a letter, and that alone would be a key that moves something else. So the
    escape key is told with the key after it."""

    def __init__(self) -> None:
        self._text = getincrementaldecoder("utf-8")("ignore")
        self._rest = ""
        self._pasting = False

    def feed(self, data: bytes) -> list[str]:
        """The keys that these bytes complete, without what is pasted."""
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
"""Keys that move: forward, to the left, counter-clockwise."""
COMMAND_S = 0.3
"""The time that one command is good for by default (gate.command_timeout_s)."""
ENDS_S = 0.35
"""After the last repeat: by then the service's timeout has stopped the wheels; where it is longer, a zero is sent."""
LONGEST_DELAY_S = 0.8
"""A terminal's first repeat of a key comes before that."""
REPEAT_S = 0.15
"""From a repeat to the next."""
NO_VELOCITY = (0.0, 0.0, 0.0)
MOST_AT_ONCE = 5
"""More motion keys in one read than a terminal sends between two looks: they were held up on the way, and are old."""


class Hold:
    """Whether a key that moves is held, as far as its repeats tell, and what is to be sent for it."""

    def __init__(self) -> None:
        self.active = False
        """True while one is held."""
        self.jerks = False
        """A key's first repeat came later than its command counts, so the wheels stopped between. It is known only once
        a second repeat has followed: a person who taps twice looks the same until then."""
        self._until_s = 0.0
        """When it ends unless it is repeated."""
        self._last = ("", 0.0)
        """The last key that moves, and when it came."""
        self._late = False
        """It came as a first repeat does that is late."""

    def pressed(self, keys: list[str], now_s: float) -> Velocity | None:
        """The command for these keys, or for the time without any: each axis within -1 to 1; None: there is none."""
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
        """Forget the held key; what to send for it."""
        was_active, self.active = self.active, False
        return NO_VELOCITY if was_active else None
