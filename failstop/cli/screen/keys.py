"""Keys: turns the bytes from a terminal into the velocity for the key that is held. Pure, because the time is an
argument.

A terminal repeats a key's bytes while the key is held, and sends nothing when it is released. If several keys are held,
the terminal repeats only the last one. Each repeat becomes one command, and the service obeys a command for the command
timeout (0.3 s). So the robot stops when the bytes end, for example because the key is released, the connection is lost,
or a program is suspended.

Even a tap drives the robot for one command timeout. The terminal begins to repeat a key 250 to 660 ms after the press.
If the command timeout is shorter than this delay, the wheels stop for a moment before the key repeats. After a release,
the robot drives until one command timeout after the key's last repeat.
"""

from __future__ import annotations

import re
from codecs import getincrementaldecoder

SPACE = " "
CTRL_D = "\x04"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_PASTED = {"200": True, "201": False}
"""The numbers of the escape sequences that a terminal sends before (True) and after (False) pasted text."""
_LONGEST = 64
"""The longest escape sequence, in characters. Anything longer is noise."""
_TOKEN = re.compile(r"\x1b\[([ -?]*)([@-~]|(?=[^ -~]))|\x1bO(.)|([^\x1b]|\x1b(?=[^\[O]))", re.DOTALL)
"""Matches one of three things: an escape sequence `ESC [ parameters final`, which another character may have cut off;
an arrow key in application mode, `ESC O letter`; or a single character."""

_MOUSE = re.compile(rb"\x1b\[M[!-\xff]{3}")
"""A report of the mouse by an old terminal, which does not know the mode 1006. Its last two bytes are the place of the
mouse, and look like keys. The left button's report has a space, which is never left out, because it stops the robot."""
_MOUSE_PART = re.compile(rb"\x1b(?:\[(?:M[!-\xff]{0,2})?)?$")
"""What may be the beginning of such a report, at the end of a read."""

Velocity = tuple[float, float, float]


class KeyDecoder:
    """Decodes a terminal's bytes into keys. A key is a character in lower case or the name of an arrow, such as `up`.

    An incomplete escape sequence is kept until the rest arrives, however long that takes. Otherwise the last letter of
    an arrow's sequence would count as a key, and move the robot in a wrong direction. So the escape key itself is
    recognized only when another key follows.
    """

    def __init__(self) -> None:
        self._text = getincrementaldecoder("utf-8")("ignore")
        self._mouse = b""
        """The beginning of a report of the mouse, whose rest has not arrived yet."""
        self._rest = ""
        self._pasting = False

    def feed(self, data: bytes) -> list[str]:
        """Add bytes, and return the keys that are complete. Keys in pasted text are left out, and so is what the mouse
        does."""
        data = _MOUSE.sub(b"", self._mouse + data)
        self._mouse = part[0] if (part := _MOUSE_PART.search(data)) else b""
        rest = self._rest + self._text.decode(data.removesuffix(self._mouse))
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
"""The keys that move the robot, each with its velocity (forward, to the left, counter-clockwise), as a share of the
full speed."""
COMMAND_S = 0.3
"""How long one command is valid by default, in seconds (setting gate.command_timeout_s)."""
ENDS_S = 0.35
"""A key counts as released this long after its last repeat, in seconds. Then teleop sends a command of zero. Usually
the service's command timeout is shorter, so it has stopped the wheels already."""
LONGEST_DELAY_S = 0.8
"""The longest time until a terminal begins to repeat a held key, in seconds."""
REPEAT_S = 0.15
"""The longest time between two repeats of a held key, in seconds."""
NO_VELOCITY = (0.0, 0.0, 0.0)
MOST_AT_ONCE = 5
"""The largest number of motion keys in one read. If a read has more, the network has delayed the keys, so they are too
old to move the robot."""


class Hold:
    """Decides from a motion key's repeats whether the key is still held, and which command to send."""

    def __init__(self) -> None:
        self.active = False
        """True while a motion key is held."""
        self.jerks = False
        """True if the terminal begins to repeat a held key so late that the wheels stop for a moment after each press.
        This is known only after the second repeat, because until then the person may have tapped the key twice."""
        self._until_s = 0.0
        """The time at which the held key counts as released (same clock as `now_s`). Each repeat postpones it."""
        self._last = ("", 0.0)
        """The last motion key, and when it came."""
        self._late = False
        """True if the last two keys were the same, and the second came after the command of the first had expired. Then
        the second may be the first repeat of a held key."""

    def pressed(self, keys: list[str], now_s: float) -> Velocity | None:
        """Return the command to send, with each axis from -1 to 1, or None to send nothing. `keys`: the keys that were
        typed since the last call; may be empty."""
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
        """Forget the held key. Returns zero velocity, which teleop must then send, or None if no key was held."""
        was_active, self.active = self.active, False
        return NO_VELOCITY if was_active else None
