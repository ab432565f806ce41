"""Keys: what a terminal sends, as key presses, repeats and releases. Pure.

Most terminals send the bytes of a key, again and again while it is held, and nothing when it is released. Those with
the kitty keyboard protocol can be asked to tell presses, repeats and releases apart (kitty's own description of it).
"""

from __future__ import annotations

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
_ESCAPE = 0x1B
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_NAMES = {9: "tab", 13: "enter", 27: "esc", 32: "space", 127: "backspace"}
_CONTROL = 4
_SHIFT = 1
_LONGEST = 64
"""No sequence is longer; what looks like one is noise."""

Key = tuple[str, int]
"""A key's name, and PRESS, REPEAT or RELEASE."""


class Decoder:
    """Bytes in, keys out. Half a sequence waits for the rest, however long: the end of an arrow key's is a letter, and
    that alone would be a key that moves something else. So the escape key is told with the key after it."""

    __slots__ = ("_pasting", "_rest")

    def __init__(self) -> None:
        self._rest = b""
        self._pasting = False

    def feed(self, data: bytes) -> list[Key]:
        """The keys that these bytes complete."""
        rest = self._rest + data
        found: list[Key] = []
        while rest:
            size, key = _sequence(rest) if rest[0] == _ESCAPE else _character(rest)
            if size == 0 and len(rest) < _LONGEST:
                break
            rest = rest[max(1, size) :]
            if key in (("paste-on", PRESS), ("paste-off", PRESS)):
                self._pasting = key[0] == "paste-on"
            elif key[0] and not self._pasting:
                found.append(key)
        self._rest = rest
        return found


def _character(data: bytes) -> tuple[int, Key]:
    """One character: (bytes taken, 0 when more are needed, its key)."""
    first = data[0]
    if first < 0x80:
        return 1, (_named(first), PRESS)
    size = 2 if first >> 5 == 0b110 else 3 if first >> 4 == 0b1110 else 4 if first >> 3 == 0b11110 else 1
    if len(data) < size:
        return 0, ("", PRESS)
    text = data[:size].decode("utf-8", "ignore")
    return size, (text.lower(), PRESS)


def _named(code: int) -> str:
    if code in _NAMES:
        return _NAMES[code]
    if code < 0x20:
        return f"ctrl+{chr(code + 0x60)}"
    return chr(code).lower() if code < 0x110000 and not 0xD800 <= code < 0xE000 else ""


def _sequence(data: bytes) -> tuple[int, Key]:
    """One escape sequence: (bytes taken, 0 when more are needed, its key; an empty name for none)."""
    if len(data) < 2:
        return 0, ("", PRESS)
    if data[1:2] == b"O":
        return (3, (_ARROWS.get(chr(data[2]), ""), PRESS)) if len(data) > 2 else (0, ("", PRESS))
    if data[1:2] != b"[":
        return 1, ("esc", PRESS)
    for at in range(2, len(data)):
        if 0x40 <= data[at] <= 0x7E:
            return at + 1, _control(data[2:at].decode("ascii", "replace"), chr(data[at]))
        if not 0x20 <= data[at] <= 0x3F:
            return at, ("", PRESS)
    return 0, ("", PRESS)


def _control(parameters: str, final: str) -> Key:
    """The key of `CSI parameters final`."""
    if final == "u" and parameters.startswith("?"):
        return (EVENTS, PRESS) if _number(parameters[1:]) & 2 else ("", PRESS)
    if final == "O" and not parameters:
        return FOCUS_OUT, PRESS
    if final == "~" and parameters in ("200", "201"):
        return ("paste-on" if parameters == "200" else "paste-off"), PRESS
    fields = parameters.split(";")
    modifiers, _, kind = (fields[1] if len(fields) > 1 else "").partition(":")
    held = max(0, _number(modifiers) - 1)
    name = _ARROWS.get(final, "")
    if final == "u":
        codes = fields[0].split(":")
        shifted = len(codes) > 1 and codes[1] and held & _SHIFT
        name = _named(_number(codes[1] if shifted else codes[0]))
        if held & _CONTROL and name:
            name = f"ctrl+{name}"
    return name, _number(kind) if kind in ("2", "3") else PRESS


def _number(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() else 0
