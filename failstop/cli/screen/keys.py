"""Keys: from the bytes of a terminal to the velocity that held keys ask for. Pure: the time is an argument.

Most terminals send the bytes of a key, again and again while it is held, and nothing when it is released. Those with
the kitty keyboard protocol can be asked to tell presses, repeats and releases apart (kitty's own description of it).

A command goes out with a key's event and counts for the service's command timeout (0.3 s); nothing else keeps the
wheels turning. So whatever ends the events - the key's release, a dead connection, a stopped program - ends the
driving. What the terminal tells decides what a press is worth:
    it only repeats      a press drives for one command timeout, then the wheels stand until the terminal's repeats
                         begin (after 250 to 660 ms): a tap is a nudge, and a release counts from the last repeat on
    it tells releases    a press drives until the release, or until repeats should have begun: a press whose release
                         got lost on the way ends then
"""

from __future__ import annotations

import re
from codecs import getincrementaldecoder

PRESS = 1
REPEAT = 2
RELEASE = 3

ASK = "\x1b[>15u\x1b[?u\x1b[?1004h\x1b[?2004h"
"""All keys as events with their kind, and the question whether that is understood; tell when the window loses the
focus; mark what is pasted. Terminals that know none of it ignore it."""
UNASK = "\x1b[?2004l\x1b[?1004l\x1b[<u"

EVENTS = "events"
"""A key's name for the answer that presses and releases are told apart."""
FOCUS_OUT = "focus-out"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_NAMES = {9: "tab", 13: "enter", 27: "esc", 32: "space", 127: "backspace"}
_CONTROL = 4
_SHIFT = 1
_LONGEST = 64
"""No sequence is longer; what looks like one is noise."""
_TOKEN = re.compile(r"\x1b\[([ -?]*)([@-~]|(?=[^ -~]))|\x1bO(.)|([^\x1b]|\x1b(?=[^\[O]))", re.DOTALL)
"""`CSI parameters final`, which something else may cut off; an arrow of the application mode; a character."""

Key = tuple[str, int]
"""A key's name, and PRESS, REPEAT or RELEASE."""
Velocity = tuple[float, float, float]


class Decoder:
    """Bytes in, keys out. Half a sequence waits for the rest, however long: the end of an arrow key's is a letter, and
    that alone would be a key that moves something else. So the escape key is told with the key after it."""

    def __init__(self) -> None:
        self._text = getincrementaldecoder("utf-8")("ignore")
        self._rest = ""
        self._pasting = False

    def feed(self, data: bytes) -> list[Key]:
        """The keys that these bytes complete."""
        rest = self._rest + self._text.decode(data)
        found: list[Key] = []
        while (token := _TOKEN.match(rest)) or len(rest) >= _LONGEST:
            rest = rest[token.end() if token else 1 :]
            parameters, final, arrow, character = token.groups() if token else (None, None, None, None)
            if final == "~" and parameters in ("200", "201"):
                self._pasting = parameters == "200"
                continue
            key = (_named(ord(character)) if character else _ARROWS.get(arrow or "", ""), PRESS)
            if final:
                key = _control(parameters or "", final)
            if key[0] and not self._pasting:
                found.append(key)
        self._rest = rest
        return found


def _named(code: int) -> str:
    if code in _NAMES:
        return _NAMES[code]
    if code < 0x20:
        return f"ctrl+{chr(code + 0x60)}"
    return chr(code).lower() if code < 0x110000 and not 0xD800 <= code < 0xE000 else ""


def _control(parameters: str, final: str) -> Key:
    """The key of `CSI parameters final`; an empty name for none."""
    if final == "u" and parameters.startswith("?"):
        return EVENTS if _number(parameters[1:]) & 2 else "", PRESS
    if final == "O" and not parameters:
        return FOCUS_OUT, PRESS
    codes, modifiers, *_ = *parameters.split(";"), "", ""
    modifier, _, kind = modifiers.partition(":")
    held = max(0, _number(modifier) - 1)
    name = _ARROWS.get(final, "")
    if final == "u":
        code, _, shifted = codes.partition(":")
        shifted = shifted.partition(":")[0] if held & _SHIFT else ""
        name = _named(_number(shifted or code))
        if held & _CONTROL and name:
            name = f"ctrl+{name}"
    return name, _number(kind) if kind in ("2", "3") else PRESS


def _number(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() else 0


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
"""What one command is worth by default (gate.command_timeout_s)."""
ENDS_S = 0.35
"""After the last event: by then the service's own timeout has stopped the wheels; for a source with a longer one, a
zero is sent."""
FIRST_REPEAT_S = 0.7
"""A terminal that repeats keys has begun to by then."""
RESEND_S = 0.05
STILL = (0.0, 0.0, 0.0)
MOST_AT_ONCE = 5
"""More motion keys in one read than a terminal sends between two looks: they were held up on the way, and are old."""


class Hold:
    """Which keys are held, as far as the terminal tells, and what is to be sent for them."""

    def __init__(self) -> None:
        self.releases = False
        """The terminal tells releases."""
        self._held: list[str] = []
        self._until_s = 0.0
        """When what is held ends unless another event comes."""
        self._first_until_s = 0.0
        """Until then commands are repeated without an event."""
        self._sent_s = 0.0

    @property
    def active(self) -> bool:
        """True while keys are held."""
        return bool(self._held)

    def events(self, keys: list[Key], now_s: float) -> Velocity | None:
        """What to send for these events, or for the time that has passed without any: each axis within -1 to 1; None:
        nothing."""
        if sum(name in AXES and kind != RELEASE for name, kind in keys) > MOST_AT_ONCE:
            return self.let_go()
        before, moved = self.active, False
        for name, kind in keys:
            if name == FOCUS_OUT:
                self._held.clear()
            elif name in AXES:
                moved = self._event(name, kind, now_s) or moved
        if not self._held:
            return STILL if before or moved else None
        if now_s >= self._until_s:
            return self.let_go()
        again = now_s < self._first_until_s and now_s - self._sent_s >= RESEND_S
        if not (moved or again):
            return None
        self._sent_s = now_s
        axes = zip(*(AXES[key] for key in self._held), strict=True)
        x, y, turn = (max(-1.0, min(1.0, sum(axis))) for axis in axes)
        return x, y, turn

    def _event(self, name: str, kind: int, now_s: float) -> bool:
        """True when it asks for motion."""
        if kind == RELEASE:
            if name in self._held:
                self._held.remove(name)
            return self.active
        if not self.releases:
            self._held.clear()  # of several keys such a terminal repeats the last one alone
        if name not in self._held:
            if kind == REPEAT:
                return False  # let go by something else: it counts again when it is pressed again
            self._held.append(name)
        self._first_until_s = now_s + FIRST_REPEAT_S if kind == PRESS and self.releases else 0.0
        self._until_s = max(self._first_until_s, now_s) + ENDS_S
        return True

    def let_go(self) -> Velocity | None:
        """Forget the held keys; what to send for it."""
        was_active, self._held = self.active, []
        return STILL if was_active else None
